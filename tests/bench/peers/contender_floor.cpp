// What reading all coordinates once costs: no partition can be faster that looks at every particle.
#include "tests/bench/measure.hpp"
#include "tests/bench/peers/contender.hpp"

namespace rcb::bench {
namespace {

class ReadFloor final : public Contender {
 public:
  ReadFloor() : Contender({kFloor, kRead, kPartition, 0}) {}
  Status prepare(const Problem& problem) override {
    problem_ = problem;
    return {};
  }
  void reset() override {}
  Status run() override {
    sum_ = read_positions(problem_.particles);
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
