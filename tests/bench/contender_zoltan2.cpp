// Zoltan2's MultiJagged as a contender. The problem object is made once and solved again and again, as a simulation
// would; its memory is kept between runs by the allocator's settings (worker.cpp). No part boxes are asked for, which
// is faster.
#include "tests/bench/contender.hpp"
#include "tests/bench/multijagged.hpp"

namespace rcb::bench {
namespace {

class MultiJaggedContender final : public Contender {
 public:
  using Contender::Contender;

  Status prepare(const Problem& problem) override {
    count_ = problem.particles.count;
    const auto& particles = problem.particles;
    return status(jagged_.prepare(particles.dims, count_, particles.position, particles.id, problem.parts));
  }
  void reset() override {}
  Status run() override { return status(jagged_.solve()); }
  Answer answer() override {
    Answer answer;
    answer.part.assign(jagged_.parts(), jagged_.parts() + count_);
    return answer;
  }

 private:
  static Status status(const std::string& failure) {
    return failure.empty() ? Status{} : Status(Code::internal, "Zoltan2: " + failure);
  }

  std::size_t count_ = 0;
  MultiJagged jagged_;
};

}  // namespace

void add_zoltan2(const Wish& wish, Contenders& out) {
  if (!wish.has("MJ")) return;
  out.push_back(std::make_unique<MultiJaggedContender>(Setting{"Zoltan2", "MJ", kPartition, 0}));
}

}  // namespace rcb::bench
