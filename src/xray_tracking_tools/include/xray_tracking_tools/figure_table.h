#pragma once

#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <nlohmann/json_fwd.hpp>

namespace xray_tracking
{
/// Measured figures, one row for each thing that was measured, for people and for programs.
class FigureTable
{
public:
  explicit FigureTable(std::string name) : name_(std::move(name)) {}

  void beginRow() { rows_.emplace_back(); }
  /// Adds a cell to the last row.
  void add(const std::string& column, const std::string& text);
  /// @param value a number that is not finite is an empty cell and JSON's null
  void add(const std::string& column, double value, int decimals = 3);

  const std::string& name() const { return name_; }
  /// Aligned columns; those of rows that lack a column are empty.
  std::string text() const;
  /// An array with one object for each row.
  nlohmann::json json() const;

private:
  struct Cell
  {
    std::string column;
    std::string text;
    std::optional<double> number;
  };

  std::string name_;
  std::vector<std::vector<Cell>> rows_;
};

/// Prints the tables, and writes them to a JSON file, an object with a member for each table, unless `path` is empty.
/// @throws std::runtime_error naming the file if it cannot be written
void report(const std::vector<FigureTable>& tables, const std::string& path);
}  // namespace xray_tracking
