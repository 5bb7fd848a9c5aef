#include "xray_tracking_conversions/parameters.h"

#include <cmath>
#include <stdexcept>

#include <gtest/gtest.h>

namespace xray_tracking
{
namespace
{
XmlRpc::XmlRpcValue valueOf(const std::string& xml)
{
  int at = 0;
  return { xml, &at };
}

std::string list(const std::string& elements)
{
  return "<value><array><data>" + elements + "</data></array></value>";
}

/// Of one parameter, `key`, given as the parameter server sends it.
ParameterReader readerOf(const std::string& xml)
{
  XmlRpc::XmlRpcValue values;
  values["key"] = valueOf(xml);
  return { "/node", values };
}

template <typename Value>
void expectRefused(const std::string& xml, const Value& fallback, const std::string& expected)
{
  SCOPED_TRACE(xml);
  try
  {
    readerOf(xml).read("key", fallback);
    FAIL() << "read";
  }
  catch (const std::invalid_argument& error)
  {
    const std::string message = error.what();
    EXPECT_EQ(message.find("parameter /node/key is "), 0U) << message;
    const std::string end = ", expected " + expected;
    EXPECT_EQ(message.rfind(end) + end.size(), message.size()) << message;
  }
}

TEST(Parameters, areReadAsWhatTheyAre)
{
  EXPECT_TRUE(readerOf("<value><boolean>1</boolean></value>").read("key", false));
  EXPECT_EQ(readerOf("<value><int>-7</int></value>").read("key", 3), -7);
  EXPECT_EQ(readerOf("<value><double>-7.0</double></value>").read("key", 3), -7);
  EXPECT_EQ(readerOf("<value><double>2.5</double></value>").read("key", 3.0), 2.5);
  EXPECT_EQ(readerOf("<value><int>-7</int></value>").read("key", 3.0), -7.0);
  EXPECT_EQ(readerOf("<value>text</value>").read("key", std::string()), "text");
  const std::string numbers = list("<value><int>1</int></value><value><double>2.5</double></value>");
  EXPECT_EQ(readerOf(numbers).read("key", std::vector<double>{ 7.0 }), (std::vector<double>{ 1.0, 2.5 }));
  EXPECT_EQ(readerOf(list("<value>a</value>")).read("key", std::vector<std::string>()),
            std::vector<std::string>{ "a" });
  EXPECT_TRUE(readerOf(list("")).read("key", std::vector<double>{ 7.0 }).empty());
}

TEST(Parameters, fallBackWhereTheyAreNotSet)
{
  EXPECT_EQ(readerOf("<value><int>1</int></value>").read("other", 3), 3);
  EXPECT_EQ(readerOf("<value><int>1</int></value>").read("key/below", 3), 3);
  EXPECT_EQ(ParameterReader("/node", {}).read("key", std::string("none")), "none");
  EXPECT_FALSE(ParameterReader("/node", {}).has("key"));
}

TEST(Parameters, areFoundInTheirNamespaces)
{
  XmlRpc::XmlRpcValue values;
  values["gate"]["max_age"] = 0.5;
  ParameterReader reader("/room/node", values);
  EXPECT_TRUE(reader.has("gate"));
  EXPECT_TRUE(reader.has("gate/max_age"));
  EXPECT_FALSE(reader.has("max_age"));
  EXPECT_EQ(reader.read("gate/max_age", 0.1), 0.5);
  EXPECT_EQ(reader.nameOf("gate/max_age"), "/room/node/gate/max_age");
}

TEST(Parameters, ofAnotherTypeAreRefused)
{
  const std::string whole = "<value><int>1</int></value>";
  const std::string text = "<value>1</value>";
  expectRefused(whole, false, "true or false");
  expectRefused(text, 0, "a whole number");
  for (const std::string number : { "2.5", "2147483648.0", "-1e300", "nan", "inf" })
  {
    expectRefused("<value><double>" + number + "</double></value>", 0, "a whole number");
  }
  expectRefused("<value><boolean>1</boolean></value>", 0.0, "a number");
  expectRefused(text, 0.0, "a number");
  expectRefused(whole, std::string(), "a text");
  expectRefused(whole, std::vector<double>(), "a list of numbers");
  expectRefused(list(whole + text), std::vector<double>(), "a list of numbers");
  expectRefused(list(text + whole), std::vector<std::string>(), "a list of texts");
  expectRefused(list(list(text)), std::vector<std::string>(), "a list of texts");
}
}  // namespace
}  // namespace xray_tracking
