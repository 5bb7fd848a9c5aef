#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <initializer_list>
#include <optional>
#include <set>
#include <sstream>
#include <stdexcept>
#include <string>
#include <system_error>
#include <type_traits>
#include <utility>
#include <vector>

#include <yaml-cpp/eventhandler.h>
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
    std::error_code error;
    const std::uintmax_t bytes = std::filesystem::file_size(path, error);
    if (!error && bytes > kMostBytes)
    {
      throw std::runtime_error(path + ": is " + std::to_string(bytes >> 20) + " MB, expected keys with values in " +
                               std::to_string(kMostBytes >> 20) + " MB at most");
    }
    std::ifstream file(path);
    file.peek();
    if (!file.is_open() || file.bad())  // bad: a folder
    {
      throw std::runtime_error(path + ": missing or not readable");
    }
    std::ostringstream text;
    text << file.rdbuf();
    return fromText(text.str(), path);
  }
  /// @param name what stands for the file in messages, and where relative paths start
  static YamlField fromText(const std::string& text, const std::string& name)
  {
    try
    {
      const YamlField root(name, "", YAML::Load(text));
      if (!root.node_.IsMap())
      {
        throw std::runtime_error(name + ": expected keys with values");
      }
      requireOneDocument(text, name);
      int left = kMostNodes;
      root.requireKeysOnce(left, 0);
      return root;
    }
    catch (const YAML::Exception& error)
    {
      throw std::runtime_error(name + ": not YAML: " + error.what());
    }
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

  /// Refuses a key that is none of those that are known, but nearly: what it says would be left out without a word.
  void refuseMisspelt(std::initializer_list<const char*> known) const
  {
    forEachEntry(
        [&](const std::string& key, const YamlField& field)
        {
          for (const char* const name : known)
          {
            if (key == name)
            {
              return;
            }
          }
          for (const char* const name : known)
          {
            if (isNearly(key, name))
            {
              throw std::runtime_error(field.where() + ": is none of the keys: did you mean " + name + "?");
            }
          }
        });
  }

private:
  static constexpr std::uintmax_t kMostBytes = 16 << 20;
  static constexpr int kMostNodes = 1000000;  // aliases may stand for more than there is
  static constexpr int kDeepest = 64;

  /// A key that stands twice has two values, of which nobody knows which is meant.
  void requireKeysOnce(int& left, int depth) const
  {
    if (--left < 0 || depth > kDeepest)
    {
      throw std::runtime_error(file_ + ": nested too deeply, or too large: expected a setup");
    }
    if (node_.IsSequence())
    {
      forEachItem([&](const YamlField& item) { item.requireKeysOnce(left, depth + 1); });
    }
    else if (node_.IsMap())
    {
      std::set<std::string> keys;
      forEachEntry(
          [&](const std::string& key, const YamlField& field)
          {
            if (key == "<<")
            {
              throw std::runtime_error(field.where() + ": merged keys are not read: expected them in full");
            }
            if (!keys.insert(key).second)
            {
              throw std::runtime_error(field.where() + " is there twice: expected each key once");
            }
            field.requireKeysOnce(left, depth + 1);
          });
    }
  }

  /// One letter in six or fewer is another, missing, too many or exchanged with its neighbour; two in more.
  static bool isNearly(const std::string& key, const std::string& name)
  {
    const std::size_t most = name.size() > 6 ? 2 : 1;
    if (name.size() < 4 || key.size() > name.size() + most || name.size() > key.size() + most)
    {
      return false;
    }
    std::vector<std::vector<std::size_t>> edits(key.size() + 1, std::vector<std::size_t>(name.size() + 1));
    for (std::size_t i = 0; i <= key.size(); ++i)
    {
      for (std::size_t j = 0; j <= name.size(); ++j)
      {
        if (i == 0 || j == 0)
        {
          edits[i][j] = i + j;
          continue;
        }
        edits[i][j] = std::min(
            { edits[i - 1][j] + 1, edits[i][j - 1] + 1, edits[i - 1][j - 1] + (key[i - 1] == name[j - 1] ? 0 : 1) });
        if (i > 1 && j > 1 && key[i - 1] == name[j - 2] && key[i - 2] == name[j - 1])
        {
          edits[i][j] = std::min(edits[i][j], edits[i - 2][j - 2] + 1);
        }
      }
    }
    return edits[key.size()][name.size()] <= most;
  }

  /// Passes over what a document holds.
  struct Ignored : YAML::EventHandler
  {
    using Style = YAML::EmitterStyle::value;

    void OnDocumentStart(const YAML::Mark&) override {}
    void OnDocumentEnd() override {}
    void OnNull(const YAML::Mark&, YAML::anchor_t) override {}
    void OnAlias(const YAML::Mark&, YAML::anchor_t) override {}
    void OnScalar(const YAML::Mark&, const std::string&, YAML::anchor_t, const std::string&) override {}
    void OnSequenceStart(const YAML::Mark&, const std::string&, YAML::anchor_t, Style) override {}
    void OnSequenceEnd() override {}
    void OnMapStart(const YAML::Mark&, const std::string&, YAML::anchor_t, Style) override {}
    void OnMapEnd() override {}
  };

  /// Not by YAML::LoadAll: of a stray % it makes documents without an end.
  static void requireOneDocument(const std::string& text, const std::string& name)
  {
    std::istringstream stream(text);
    YAML::Parser parser(stream);
    Ignored ignored;
    if (parser.HandleNextDocument(ignored) && parser.HandleNextDocument(ignored))
    {
      throw std::runtime_error(name + ": has 2 documents or more, parted by ---: expected one");
    }
  }

  YamlField(std::string file, std::string key, const YAML::Node& node)
    : file_(std::move(file)), key_(std::move(key)), node_(node)
  {
  }

  std::string file_;
  std::string key_;
  YAML::Node node_;
};
}  // namespace xray_tracking
