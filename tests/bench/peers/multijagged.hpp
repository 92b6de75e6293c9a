// Zoltan2's MultiJagged behind plain types: its headers are C++17 (they don't compile as C++20) and full of warnings,
// so one file of its own includes them.
//
// No exception leaves these calls: an empty text is success, any other says what failed.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>

namespace rcb::bench {

void start_zoltan2(int* argc, char*** argv);  // Collective, after MPI_Init
void finish_zoltan2();                        // Collective, before MPI_Finalize

class MultiJagged {
 public:
  MultiJagged();
  ~MultiJagged();
  MultiJagged(const MultiJagged&) = delete;
  MultiJagged& operator=(const MultiJagged&) = delete;

  // Collective. The arrays outlive the calls below. keep_boxes: owner() will be asked.
  std::string prepare(int dims, std::size_t count, const std::array<const double*, 3>& position, const std::int64_t* id,
                      int parts, bool keep_boxes);
  // Collective.
  std::string solve();
  // [count], of the last solve(). Local.
  const int* parts() const;
  // The part that a point [dims] is assigned to after the last solve(); -1 where that fails. Local, linear in the
  // parts.
  int owner(int dims, double* point) const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace rcb::bench
