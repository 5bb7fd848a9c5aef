// Readers of bytes from outside, with what fuzzers found (fuzz/corpus) and with bytes that a seeded hand has changed.
#include "readers.h"

#include <algorithm>
#include <array>
#include <cstddef>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <random>

#include <gtest/gtest.h>

namespace xray_tracking
{
namespace
{
struct Input
{
  std::string name;
  std::string bytes;
};

std::vector<Input> corpusOf(const Reader& reader)
{
  std::vector<Input> inputs;
  for (const auto& entry : std::filesystem::directory_iterator(std::string(FUZZ_FOLDER) + "/corpus/" + reader.name))
  {
    std::ifstream file(entry.path(), std::ios::binary);
    inputs.push_back({ entry.path().filename().string(), std::string(std::istreambuf_iterator<char>(file), {}) });
  }
  std::sort(inputs.begin(), inputs.end(), [](const Input& a, const Input& b) { return a.name < b.name; });
  return inputs;
}

class Hand
{
public:
  explicit Hand(unsigned seed) : random_(seed) {}

  std::size_t below(std::size_t count) { return count == 0 ? 0 : random_() % count; }

  std::string changed(std::string bytes, const std::string& other)
  {
    for (std::size_t changes = 1 + below(4); changes > 0; --changes)
    {
      change(bytes, other);
    }
    return bytes;
  }

private:
  void change(std::string& bytes, const std::string& other)
  {
    static const std::vector<std::string> kWords{
      "nan", "-1", "0",  "1e308", "99999999999",       "inf", "\xff\xff\xff\xff", "\x7f\xff",
      "\n",  ",",  ": ", "\"",    std::string(2, '\0')
    };
    const std::size_t at = below(bytes.size() + 1);
    const std::size_t length = below(std::min<std::size_t>(bytes.size() - at, 40) + 1);
    switch (below(8))
    {
      case 0:
        bytes.resize(at);
        return;
      case 1:
        bytes.erase(at, length);
        return;
      case 2:
        bytes.insert(at, bytes.substr(at, length));
        return;
      case 3:
        bytes.insert(at, other.substr(below(other.size()), length));
        return;
      case 4:
        bytes.replace(at, std::min(length, bytes.size() - at), kWords[below(kWords.size())]);
        return;
      case 5:
      {
        const std::string& word = kWords[below(kWords.size())];
        bytes.replace(at, std::min(word.size(), bytes.size() - at), word);
        return;
      }
      default:
        if (at < bytes.size())
        {
          bytes[at] = static_cast<char>(bytes[at] ^ 1 << below(8));
        }
    }
  }

  std::mt19937 random_;
};

class Readers : public testing::TestWithParam<Reader>
{
};

TEST_P(Readers, readWhatIsWellFormed)
{
  // Of the corpus, what bears the name of what is wrong with it is refused; but for that, all of it is read.
  int read = 0;
  for (const Input& input : corpusOf(GetParam()))
  {
    SCOPED_TRACE(input.name);
    const std::string refusal = refusalOf(GetParam(), input.bytes);
    const bool is_bad = input.name.compare(0, 4, "bad_") == 0;
    EXPECT_EQ(is_bad, !refusal.empty()) << refusal;
    read += refusal.empty() ? 1 : 0;
  }
  EXPECT_GT(read, 0);
}

TEST_P(Readers, refuseWhatIsNotOrReadIt)
{
  constexpr int kCount = 300;
  const std::vector<Input> inputs = corpusOf(GetParam());
  Hand hand(19);
  int refused = 0;
  for (int n = 0; n < kCount; ++n)
  {
    const std::string bytes =
        hand.changed(inputs[hand.below(inputs.size())].bytes, inputs[hand.below(inputs.size())].bytes);
    SCOPED_TRACE(n);
    refused += refusalOf(GetParam(), bytes).empty() ? 0 : 1;
  }
  EXPECT_GT(refused, kCount / 20);
}

INSTANTIATE_TEST_SUITE_P(, Readers, testing::ValuesIn(readers()),
                         [](const testing::TestParamInfo<Reader>& info) { return info.param.name; });
}  // namespace
}  // namespace xray_tracking
