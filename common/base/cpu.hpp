// Instruction sets that the processor has beyond those that the program is compiled for.
#pragma once

namespace rcb {

#if defined(__x86_64__)
inline bool has_avx2() {
  static const bool has = __builtin_cpu_supports("avx2") != 0;
  return has;
}
#endif

}  // namespace rcb
