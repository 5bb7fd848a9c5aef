#include "xray_tracking_tools/graph_connections.h"

#include <set>
#include <utility>

#include <ros/master.h>
#include <ros/network.h>
#include <ros/this_node.h>
#include <xmlrpcpp/XmlRpc.h>

namespace xray_tracking
{
namespace
{
using XmlRpc::XmlRpcValue;

/// (topic, node) of every outgoing connection of a node; empty if it does not answer.
std::set<std::pair<std::string, std::string>> outgoingConnections(const std::string& node)
{
  std::set<std::pair<std::string, std::string>> connections;
  XmlRpcValue request, response, payload;
  request[0] = ros::this_node::getName();
  request[1] = node;
  std::string host;
  std::uint32_t port = 0;
  if (!ros::master::execute("lookupNode", request, response, payload, false) ||
      !ros::network::splitURI(static_cast<std::string&>(payload), host, port))
  {
    return connections;
  }
  XmlRpc::XmlRpcClient client(host.c_str(), static_cast<int>(port), "/");
  XmlRpcValue own_name, bus_info;
  own_name[0] = ros::this_node::getName();
  if (!client.execute("getBusInfo", own_name, bus_info) || client.isFault() || bus_info.size() != 3)
  {
    return connections;
  }
  // Entries are (id, other node, direction, transport, topic, connected, ...).
  XmlRpcValue& entries = bus_info[2];
  for (int i = 0; i < entries.size(); ++i)
  {
    if (static_cast<std::string&>(entries[i][2]) == "o")
    {
      connections.emplace(static_cast<std::string&>(entries[i][4]), static_cast<std::string&>(entries[i][1]));
    }
  }
  return connections;
}

/// The nodes that publish each topic.
std::map<std::string, std::vector<std::string>> publishers()
{
  std::map<std::string, std::vector<std::string>> by_topic;
  XmlRpcValue request, response, state;
  request[0] = ros::this_node::getName();
  if (!ros::master::execute("getSystemState", request, response, state, false))
  {
    return by_topic;
  }
  XmlRpcValue& topics = state[0];
  for (int i = 0; i < topics.size(); ++i)
  {
    for (int j = 0; j < topics[i][1].size(); ++j)
    {
      by_topic[static_cast<std::string&>(topics[i][0])].push_back(static_cast<std::string&>(topics[i][1][j]));
    }
  }
  return by_topic;
}
}  // namespace

std::vector<std::string> missingConnections(const RequiredSubscribers& required)
{
  std::vector<std::string> missing;
  std::map<std::string, std::set<std::pair<std::string, std::string>>> connections;  // by publisher
  const std::map<std::string, std::vector<std::string>> publishers_of = publishers();
  for (const auto& [topic, subscribers] : required)
  {
    const auto found = publishers_of.find(topic);
    if (found == publishers_of.end())
    {
      missing.push_back(topic + " has no publisher");
      continue;
    }
    for (const std::string& publisher : found->second)
    {
      if (connections.count(publisher) == 0)
      {
        connections[publisher] = outgoingConnections(publisher);
      }
      for (const std::string& subscriber : subscribers)
      {
        if (connections[publisher].count({ topic, subscriber }) == 0)
        {
          missing.push_back(topic + " from " + publisher + " does not reach " + subscriber);
        }
      }
    }
  }
  return missing;
}
}  // namespace xray_tracking
