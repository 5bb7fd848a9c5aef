# Writes revision.h: what the program was built from. Run at every build; the file changes only with the revision.
execute_process(COMMAND git -C ${SOURCE_DIR} describe --always --dirty --abbrev=12
                OUTPUT_VARIABLE revision OUTPUT_STRIP_TRAILING_WHITESPACE ERROR_QUIET RESULT_VARIABLE failed)
if(failed)
  set(revision "unknown")
endif()
file(WRITE ${OUTPUT}.new "#pragma once
namespace xray_tracking
{
constexpr const char* kVersion = \"${VERSION}\";
constexpr const char* kRevision = \"${revision}\";
}  // namespace xray_tracking
")
execute_process(COMMAND ${CMAKE_COMMAND} -E copy_if_different ${OUTPUT}.new ${OUTPUT})
