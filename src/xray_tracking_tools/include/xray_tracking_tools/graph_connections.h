#pragma once

#include <map>
#include <string>
#include <vector>

namespace xray_tracking
{
/// Node names by the topic that they must receive; names are resolved ones ("/ns/name").
using RequiredSubscribers = std::map<std::string, std::vector<std::string>>;

/// Which of the required connections do not stand yet, a text for each; empty once every publisher of every topic
/// sends to every node named. Asks the publishers themselves (their `getBusInfo`): the master only knows who wants to
/// subscribe, and a message published between that and the connection is gone. Blocks while it asks.
std::vector<std::string> missingConnections(const RequiredSubscribers& required);
}  // namespace xray_tracking
