// Where exceptions may go no further: out of a thread, or into a caller of another language.
#pragma once

#include <exception>
#include <new>

#include "common/base/status.hpp"

namespace rcb {

// What work() returns, or the failure that an exception stands for.
template <typename Work>
Status without_exceptions(const Work& work) noexcept {
  try {
    return work();
  } catch (const std::bad_alloc&) {
    return {Code::too_large, "no memory"};  // so short that it needs none
  } catch (const std::exception&) {
    return {Code::internal, "an exception"};
  }
}

}  // namespace rcb
