#pragma once

// Compiled for several processors, of which the loader takes the best that there is; XRAY_TRACKING_PLAIN_KERNELS: for
// any, as elsewhere than on x86-64.
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && !defined(XRAY_TRACKING_PLAIN_KERNELS)
#define FOR_SEVERAL_PROCESSORS __attribute__((target_clones("avx512f", "avx2", "default")))
#else
#define FOR_SEVERAL_PROCESSORS
#endif
