// Highway, for a source of kernels: vector code that is written once and compiled for each instruction set. The source
// defines HWY_TARGET_INCLUDE as its own name and includes this header, which includes the source again for each set, so
// it has no guard as a whole. What belongs to all sets at once stands below `#if HWY_ONCE`. Highway's headers alone are
// used: its own choice of a set, HWY_DYNAMIC_DISPATCH, would need its library.
#ifndef RCB_HIGHWAY
#define RCB_HIGHWAY

// AVX2, AVX-512 and NEON are enough. (Below HWY_AVX3 are the bits of the newer ones, of which each version knows more.)
#define HWY_DISABLED_TARGETS (HWY_SSSE3 | HWY_SSE4 | (HWY_AVX3 - 1) | HWY_SVE | HWY_SVE2 | HWY_SVE_256 | HWY_SVE2_128)
// What instruction_set() doesn't ask for.
#define HWY_DISABLE_PCLMUL_AES
#define HWY_DISABLE_F16C
#define HWY_DISABLE_BMI2_FMA
#define HWY_IS_DEBUG_BUILD 0

#include "common/base/cpu.hpp"

// The variable of this name of the instruction set that is to be used.
#if defined(__x86_64__)
#define RCB_OF_INSTRUCTION_SET(name, set)                \
  ((set) == ::rcb::InstructionSet::avx512 ? N_AVX3::name \
   : (set) == ::rcb::InstructionSet::avx2 ? N_AVX2::name \
                                          : HWY_STATIC_DISPATCH(name))
#else
#define RCB_OF_INSTRUCTION_SET(name, set) (static_cast<void>(set), HWY_STATIC_DISPATCH(name))
#endif

#endif

#include <hwy/foreach_target.h>
#include <hwy/highway.h>
