#include "xray_tracking_tools/figure_table.h"

#include <algorithm>
#include <cmath>
#include <iomanip>
#include <iostream>
#include <sstream>

#include <nlohmann/json.hpp>

#include "xray_tracking_tools/json_file.h"

namespace xray_tracking
{
void FigureTable::add(const std::string& column, const std::string& text)
{
  rows_.back().push_back({ column, text, std::nullopt });
}

void FigureTable::add(const std::string& column, double value, int decimals)
{
  std::ostringstream text;
  if (std::isfinite(value))
  {
    text << std::fixed << std::setprecision(decimals) << value;
  }
  rows_.back().push_back({ column, text.str(), value });
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
        is_number.push_back(cell.number.has_value());
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

nlohmann::json FigureTable::json() const
{
  nlohmann::json rows = nlohmann::json::array();
  for (const std::vector<Cell>& row : rows_)
  {
    nlohmann::json& object = rows.emplace_back(nlohmann::json::object());
    for (const Cell& cell : row)
    {
      if (cell.number)
      {
        object[cell.column] = *cell.number;
      }
      else
      {
        object[cell.column] = cell.text;
      }
    }
  }
  return rows;
}

void report(const std::vector<FigureTable>& tables, const std::string& path)
{
  nlohmann::json json = nlohmann::json::object();
  for (const FigureTable& table : tables)
  {
    std::cout << table.text() << "\n";
    json[table.name()] = table.json();
  }
  std::cout << std::flush;
  if (!path.empty())
  {
    writeJsonFile(path, json);
  }
}
}  // namespace xray_tracking
