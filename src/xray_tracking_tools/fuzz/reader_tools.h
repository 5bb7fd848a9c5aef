#pragma once

#include <string>

#include "readers.h"
#include "xray_tracking_core/sequence/treatment_setup.h"

namespace xray_tracking
{
/// Of what a message is about: the file, the topic, an option, a field.
extern std::string expected_name;

/// A folder of this process, gone when it ends.
const std::string& folder();

/// Writes a file of the folder, and expects messages about it. @return its path
std::string writeFile(const std::string& name, const std::string& bytes);

/// @throws std::logic_error if it is missing
std::string corpusFile(const std::string& name);

/// The setup of the other readers: two views of 8 x 6 pixels.
const TreatmentSetup& setup();

/// @throws std::logic_error unless what was read holds
void require(bool holds, const char* what);

// Of files, messages and parameters.
std::vector<Reader> fileReaders();
std::vector<Reader> messageReaders();
std::vector<Reader> parameterReaders();
}  // namespace xray_tracking
