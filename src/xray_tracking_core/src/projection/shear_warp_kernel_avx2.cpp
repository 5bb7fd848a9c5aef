#define SHEAR_WARP_KERNELS kAvx2Kernels
#include "shear_warp_kernel.inl"
