#pragma once

#include "benchmark_table.h"
#include "planar_scene.h"

namespace xray_tracking
{
/// Times, errors against the Cramer-Rao bound, and capture ranges, all with this motion model on this kind of motion.
BenchmarkTable benchmarkModel(const PlanarScene& scene, MotionModel model);

/// Errors and lost exposures under gain, offset, shading and occlusion; translation.
BenchmarkTable benchmarkConditions(const PlanarScene& scene);
}  // namespace xray_tracking
