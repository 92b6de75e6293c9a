// Asks the processor for memory that will be read soon.
#pragma once

#include <cstddef>
#include <cstdint>

namespace rcb {

// The element `ahead` of `from`. It may lie beyond the array, where not even a pointer may be: hence the integer.
template <typename T>
[[gnu::always_inline]] inline void prefetch(const T* from, std::size_t ahead) {
  const std::uintptr_t address = reinterpret_cast<std::uintptr_t>(from) + ahead * sizeof(T);
  __builtin_prefetch(reinterpret_cast<const void*>(address));
}

}  // namespace rcb
