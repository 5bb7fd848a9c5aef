#include "xray_tracking_tools/figure_table.h"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <iomanip>
#include <iostream>
#include <sstream>
#include <stdexcept>

namespace xray_tracking
{
void FigureTable::add(const std::string& column, const std::string& text)
{
  rows_.back().push_back({ column, text, false });
}

void FigureTable::add(const std::string& column, double value, int decimals)
{
  std::ostringstream text;
  if (std::isfinite(value))
  {
    text << std::fixed << std::setprecision(decimals) << value;
  }
  rows_.back().push_back({ column, text.str(), true });
}

std::string FigureTable::text() const
{
  std::vector<std::string> columns;
  std::vector<bool> is_number;
  for (const std::vector<Cell>& row : rows_)
  {
    for (const Cell& cell : row)
    {
      if (std::find(columns.begin(), columns.end(), cell.column) == columns.end())
      {
        columns.push_back(cell.column);
        is_number.push_back(cell.is_number);
      }
    }
  }
  std::vector<std::vector<std::string>> lines(rows_.size() + 1);
  for (const std::string& column : columns)
  {
    lines[0].push_back(column);
    for (std::size_t n = 0; n < rows_.size(); ++n)
    {
      const auto cell = std::find_if(rows_[n].begin(), rows_[n].end(),
                                     [&](const Cell& candidate) { return candidate.column == column; });
      lines[n + 1].push_back(cell == rows_[n].end() ? "" : cell->text);
    }
  }
  std::ostringstream out;
  out << name_ << "\n";
  for (const std::vector<std::string>& line : lines)
  {
    for (std::size_t c = 0; c < columns.size(); ++c)
    {
      std::size_t width = 0;
      for (const std::vector<std::string>& other : lines)
      {
        width = std::max(width, other[c].size());
      }
      out << (is_number[c] ? std::right : std::left) << std::setw(static_cast<int>(width)) << line[c] << "  ";
    }
    out << "\n";
  }
  return out.str();
}

std::string FigureTable::json() const
{
  std::ostringstream out;
  out << "[";
  for (std::size_t n = 0; n < rows_.size(); ++n)
  {
    out << (n == 0 ? "\n    {" : ",\n    {");
    for (std::size_t c = 0; c < rows_[n].size(); ++c)
    {
      const Cell& cell = rows_[n][c];
      out << (c == 0 ? "" : ", ") << std::quoted(cell.column) << ": ";
      if (cell.is_number)
      {
        out << (cell.text.empty() ? "null" : cell.text);
      }
      else
      {
        out << std::quoted(cell.text);
      }
    }
    out << "}";
  }
  out << "\n  ]";
  return out.str();
}

void report(const std::vector<FigureTable>& tables, const std::string& path)
{
  std::ostringstream json;
  for (const FigureTable& table : tables)
  {
    std::cout << table.text() << "\n";
    json << (json.tellp() == 0 ? "{\n  " : ",\n  ") << std::quoted(table.name()) << ": " << table.json();
  }
  std::cout << std::flush;
  if (path.empty())
  {
    return;
  }
  std::ofstream file(path);
  file << json.str() << "\n}\n";
  if (!file.flush())
  {
    throw std::runtime_error(path + ": cannot be written");
  }
}
}  // namespace xray_tracking
