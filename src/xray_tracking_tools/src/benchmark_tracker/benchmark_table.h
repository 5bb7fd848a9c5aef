#pragma once

#include <iosfwd>
#include <string>
#include <utility>
#include <vector>

#include <nlohmann/json_fwd.hpp>

namespace xray_tracking
{
/// Figures of one kind for several contestants; NaN where there is none.
struct BenchmarkTable
{
  std::string title;
  std::vector<std::string> columns;
  std::vector<std::pair<std::string, std::vector<double>>> rows;  ///< name and one value a column
};

void printTable(std::ostream& out, const BenchmarkTable& table);
/// One object a table: {title: {row: {column: value}}}; null for NaN.
nlohmann::json toJson(const std::vector<BenchmarkTable>& tables);
}  // namespace xray_tracking
