#include "benchmark_table.h"

#include <algorithm>
#include <cmath>
#include <iomanip>
#include <ostream>
#include <sstream>

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

void writeJson(std::ostream& out, const std::vector<BenchmarkTable>& tables)
{
  const auto quoted = [](const std::string& text) { return '"' + text + '"'; };
  out << "{";
  for (std::size_t t = 0; t < tables.size(); ++t)
  {
    const BenchmarkTable& table = tables[t];
    out << (t == 0 ? "\n  " : ",\n  ") << quoted(table.title) << ": {";
    for (std::size_t r = 0; r < table.rows.size(); ++r)
    {
      out << (r == 0 ? "\n    " : ",\n    ") << quoted(table.rows[r].first) << ": {";
      for (std::size_t c = 0; c < table.columns.size(); ++c)
      {
        out << (c == 0 ? "" : ", ") << quoted(table.columns[c]) << ": ";
        const double value = table.rows[r].second[c];
        std::isfinite(value) ? out << value : out << "null";
      }
      out << "}";
    }
    out << "\n  }";
  }
  out << "\n}\n";
}
}  // namespace xray_tracking
