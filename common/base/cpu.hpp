// Instruction sets that the processor has beyond those that the program is compiled for.
#pragma once

#include <cstdlib>
#include <string_view>

namespace rcb {

#if defined(__x86_64__)
enum class InstructionSet { baseline, avx2, avx512 };

// What the processor has, or less where RCBD_CPU is `baseline` or `avx2`: to compare, and to test each.
inline InstructionSet instruction_set() {
  static const InstructionSet set = [] {
    const char* const named = std::getenv("RCBD_CPU");
    const std::string_view most = named == nullptr ? "" : named;
    const auto has = [](bool one, bool two) { return one && two; };
    if (most == "baseline" || !has(__builtin_cpu_supports("avx2") != 0, __builtin_cpu_supports("popcnt") != 0) ||
        __builtin_cpu_supports("bmi") == 0)
      return InstructionSet::baseline;
    if (most == "avx2" || !has(__builtin_cpu_supports("avx512f") != 0, __builtin_cpu_supports("avx512dq") != 0) ||
        !has(__builtin_cpu_supports("avx512bw") != 0, __builtin_cpu_supports("avx512vl") != 0) ||
        __builtin_cpu_supports("bmi2") == 0)
      return InstructionSet::avx2;
    return InstructionSet::avx512;
  }();
  return set;
}
inline bool has_avx2() { return instruction_set() >= InstructionSet::avx2; }
inline bool has_avx512() { return instruction_set() >= InstructionSet::avx512; }
#endif

}  // namespace rcb
