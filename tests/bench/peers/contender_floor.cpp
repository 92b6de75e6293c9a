// What reading all coordinates once costs: no partition can be faster that looks at every particle.
#include <bit>

#include "tests/bench/peers/contender.hpp"

namespace rcb::bench {
namespace {

// Sums of the bit patterns: unlike sums of doubles they may be made in any order, so the compiler uses vectors.
#if defined(__x86_64__)
__attribute__((target_clones("avx2", "default")))
#endif
std::uint64_t
sum_of(const double* values, std::size_t count) {
  std::uint64_t sum = 0;
  for (std::size_t i = 0; i < count; ++i) sum += std::bit_cast<std::uint64_t>(values[i]);
  return sum;
}

class ReadFloor final : public Contender {
 public:
  ReadFloor() : Contender({kFloor, kRead, kPartition, 0}) {}
  Status prepare(const Problem& problem) override {
    problem_ = problem;
    return {};
  }
  void reset() override {}
  Status run() override {
    std::uint64_t sum = 0;
    for (std::size_t a = 0; a < static_cast<std::size_t>(problem_.particles.dims); ++a)
      sum += sum_of(problem_.particles.position[a], problem_.particles.count);
    sum_ = sum;
    return {};
  }
  Answer answer() override { return {}; }
  std::optional<std::vector<std::int32_t>> owners() override { return std::nullopt; }

 private:
  Problem problem_;
  volatile std::uint64_t sum_ = 0;  // so that it is made
};

}  // namespace

void add_floor(const Wish& wish, Contenders& out) {
  if (wish.has(kRead)) out.push_back(std::make_unique<ReadFloor>());
}

}  // namespace rcb::bench
