#include "benchmark_table.h"

#include <algorithm>
#include <cmath>
#include <iomanip>
#include <ostream>
#include <sstream>

#include <nlohmann/json.hpp>

namespace xray_tracking
{
namespace
{
constexpr int kNameWidth = 38;
constexpr int kColumnWidth = 11;

/// Three significant digits, without exponents.
std::string figure(double value)
{
  if (!std::isfinite(value))
  {
    return "-";
  }
  std::ostringstream text;
  const double magnitude = std::abs(value);
  const bool whole = magnitude >= 100.0 || value == std::round(value);
  text << std::fixed << std::setprecision(whole ? 0 : magnitude >= 10.0 ? 1 : magnitude >= 1.0 ? 2 : 3) << value;
  return text.str();
}
}  // namespace

void printTable(std::ostream& out, const BenchmarkTable& table)
{
  out << "\n" << table.title << "\n" << std::left << std::setw(kNameWidth) << "" << std::right;
  const auto width = [](const std::string& column) { return std::max<int>(kColumnWidth, column.size() + 2); };
  for (const std::string& column : table.columns)
  {
    out << std::setw(width(column)) << column;
  }
  out << "\n";
  for (const auto& [name, values] : table.rows)
  {
    out << std::left << std::setw(kNameWidth) << name << std::right;
    for (std::size_t i = 0; i < values.size(); ++i)
    {
      out << std::setw(width(table.columns[i])) << figure(values[i]);
    }
    out << "\n";
  }
  out << std::flush;
}

nlohmann::json toJson(const std::vector<BenchmarkTable>& tables)
{
  nlohmann::json json = nlohmann::json::object();
  for (const BenchmarkTable& table : tables)
  {
    for (const auto& [name, values] : table.rows)
    {
      for (std::size_t c = 0; c < table.columns.size(); ++c)
      {
        json[table.title][name][table.columns[c]] = values[c];
      }
    }
  }
  return json;
}
}  // namespace xray_tracking
