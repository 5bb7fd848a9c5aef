#pragma once

#include <cmath>
#include <optional>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>

#include <yaml-cpp/yaml.h>
#include <Eigen/Core>

namespace xray_tracking
{
/// A value of a YAML file that knows where it stands, so that whatever is wrong with it can be named. All members throw
/// std::runtime_error naming file, key, value and what was expected.
class YamlField
{
public:
  static YamlField fromFile(const std::string& path)
  {
    return rootOf(path, [&] { return YAML::LoadFile(path); });
  }
  /// @param name what stands for the file in messages, and where relative paths start
  static YamlField fromText(const std::string& text, const std::string& name)
  {
    return rootOf(name, [&] { return YAML::Load(text); });
  }

  std::optional<YamlField> find(const std::string& key) const
  {
    if (!node_.IsMap())
    {
      fail("keys with values");
    }
    const YAML::Node child = node_[key];
    if (!child.IsDefined() || child.IsNull())
    {
      return std::nullopt;
    }
    return YamlField(file_, key_.empty() ? key : key_ + "." + key, child);
  }

  YamlField get(const std::string& key) const
  {
    if (auto child = find(key))
    {
      return *child;
    }
    throw std::runtime_error(file_ + ": " + (key_.empty() ? key : key_ + "." + key) + " is missing");
  }

  bool isScalar() const { return node_.IsScalar(); }

  /// Calls `visit(item)` for every item of a list.
  template <typename Visit>
  void forEachItem(Visit visit) const
  {
    if (!node_.IsSequence())
    {
      fail("a list");
    }
    for (std::size_t i = 0; i < node_.size(); ++i)
    {
      visit(YamlField(file_, key_ + "[" + std::to_string(i) + "]", node_[i]));
    }
  }

  /// Calls `visit(key, value)` for every entry of a map.
  template <typename Visit>
  void forEachEntry(Visit visit) const
  {
    if (!node_.IsMap())
    {
      fail("keys with values");
    }
    for (const auto& entry : node_)
    {
      const std::string key = entry.first.as<std::string>("");
      visit(key, YamlField(file_, key_ + "." + key, entry.second));
    }
  }

  std::string text() const
  {
    if (!node_.IsScalar() || node_.Scalar().empty())
    {
      fail("a text");
    }
    return node_.Scalar();
  }

  template <typename Number>
  Number number() const
  {
    const char* const expected = std::is_integral<Number>::value ? "a whole number" : "a finite number";
    Number value{};
    if (!node_.IsScalar() || !YAML::convert<Number>::decode(node_, value) || !std::isfinite(double(value)))
    {
      fail(expected);
    }
    return value;
  }

  template <typename Number, int Size>
  Eigen::Matrix<Number, Size, 1> vector() const
  {
    if (!node_.IsSequence() || node_.size() != Size)
    {
      fail("a list of " + std::to_string(Size) + " numbers");
    }
    Eigen::Matrix<Number, Size, 1> value;
    int i = 0;
    forEachItem([&](const YamlField& item) { value[i++] = item.number<Number>(); });
    return value;
  }

  [[noreturn]] void fail(const std::string& expected) const
  {
    YAML::Emitter value;
    value << YAML::Flow << node_;
    throw std::runtime_error(where() + ", is " + std::string(value.c_str()).substr(0, 120) + ": expected " + expected);
  }

  /// File, line and key.
  std::string where() const { return file_ + ", line " + std::to_string(node_.Mark().line + 1) + ": " + key_; }

private:
  template <typename Load>
  static YamlField rootOf(const std::string& name, Load load)
  {
    try
    {
      const YamlField root(name, "", load());
      if (!root.node_.IsMap())
      {
        throw std::runtime_error(name + ": expected keys with values");
      }
      return root;
    }
    catch (const YAML::BadFile&)
    {
      throw std::runtime_error(name + ": missing or not readable");
    }
    catch (const YAML::Exception& error)
    {
      throw std::runtime_error(name + ": not YAML: " + error.what());
    }
  }

  YamlField(std::string file, std::string key, YAML::Node node)
    : file_(std::move(file)), key_(std::move(key)), node_(std::move(node))
  {
  }

  std::string file_;
  std::string key_;
  YAML::Node node_;
};
}  // namespace xray_tracking
