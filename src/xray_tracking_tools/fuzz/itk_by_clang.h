// Included before everything else where clang compiles (scripts/fuzz): Debian's ITK asks which compiler it is and takes
// GNU's alone, though it is the same to clang.
#if defined(__clang__) && __has_include(<itk_compiler_detection.h>)
#pragma clang diagnostic push
#pragma clang diagnostic ignored "-Wbuiltin-macro-redefined"
#pragma push_macro("__GNUC__")
#undef __clang__
#undef __GNUC__
#define __GNUC__ 12
#include <itk_compiler_detection.h>
#define __clang__ 1
#pragma pop_macro("__GNUC__")
#pragma clang diagnostic pop
#endif
