#define SHEAR_WARP_KERNELS kAvx512Kernels
#include "shear_warp_kernel.inl"
