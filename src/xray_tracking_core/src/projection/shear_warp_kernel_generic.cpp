#define SHEAR_WARP_KERNELS kGenericKernels
#include "shear_warp_kernel.inl"
