// Instruction sets that the processor has beyond those that the program is compiled for.
#pragma once

#include <cstdlib>
#include <string_view>

namespace rcb {

// What RCBD_CPU says, `baseline` or `avx2`: to use fewer instructions than the processor has. Empty: all.
inline std::string_view cpu_asked_for() {
  const char* const named = std::getenv("RCBD_CPU");
  return named == nullptr ? "" : named;
}
inline bool cpu_is_known() {
  const std::string_view name = cpu_asked_for();
  return name.empty() || name == "baseline" || name == "avx2";
}
inline constexpr const char* kUnknownCpu = "RCBD_CPU is neither baseline nor avx2";

enum class InstructionSet { baseline, avx2, avx512 };

#if defined(__x86_64__)
// What functions for one of these sets may use, which is what instruction_set() asks for.
#define RCB_AVX2 "avx2,popcnt,bmi"
#define RCB_AVX512 RCB_AVX2 ",avx512f,avx512dq,avx512bw,avx512vl,bmi2"
#endif

// What the processor has, or less where that is asked for: to compare, and to test each.
inline InstructionSet instruction_set() {
#if defined(__x86_64__)
  static const InstructionSet set = [] {
    const std::string_view most = cpu_asked_for();
    const auto all = [](auto... supported) { return (... && (supported != 0)); };
    if (most == "baseline" || !all(__builtin_cpu_supports("avx2"), __builtin_cpu_supports("sse4.2"),
                                   __builtin_cpu_supports("popcnt"), __builtin_cpu_supports("bmi")))
      return InstructionSet::baseline;
    if (most == "avx2" ||
        !all(__builtin_cpu_supports("avx512f"), __builtin_cpu_supports("avx512dq"), __builtin_cpu_supports("avx512bw"),
             __builtin_cpu_supports("avx512vl"), __builtin_cpu_supports("bmi2")))
      return InstructionSet::avx2;
    return InstructionSet::avx512;
  }();
  return set;
#else
  return InstructionSet::baseline;
#endif
}
inline bool has_avx2() { return instruction_set() >= InstructionSet::avx2; }
inline bool has_avx512() { return instruction_set() >= InstructionSet::avx512; }

}  // namespace rcb
