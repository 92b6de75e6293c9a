// Zoltan2's MultiJagged as a contender. The problem object is made once and solved again and again, as a simulation
// would; its memory is kept between runs by the allocator's settings (worker.cpp). Part boxes are asked for only where
// owners will be, since they cost time.
#include "tests/bench/peers/contender.hpp"
#include "tests/bench/peers/multijagged.hpp"

namespace rcb::bench {
namespace {

class MultiJaggedContender final : public Contender {
 public:
  MultiJaggedContender(Setting setting, bool owners) : Contender(std::move(setting)), keep_boxes_(owners) {}

  Status prepare(const Problem& problem) override {
    particles_ = problem.particles;
    return status(jagged_.prepare(particles_.dims, particles_.count, particles_.position, particles_.id, problem.parts,
                                  keep_boxes_));
  }
  void reset() override {}
  Status run() override { return status(jagged_.solve()); }
  Answer answer() override {
    Answer answer;
    answer.part.assign(jagged_.parts(), jagged_.parts() + particles_.count);
    return answer;
  }
  std::optional<std::vector<std::int32_t>> owners() override {
    std::vector<std::int32_t> owners(particles_.count);
    for (std::size_t i = 0; i < owners.size(); ++i) {
      geometry::Point point = particles_.point(i);
      owners[i] = jagged_.owner(particles_.dims, point.data());
    }
    return owners;
  }

 private:
  static Status status(const std::string& failure) {
    return failure.empty() ? Status{} : Status(Code::internal, "Zoltan2: " + failure);
  }

  particles::ParticleView particles_;
  bool keep_boxes_;
  MultiJagged jagged_;
};

}  // namespace

void add_zoltan2(const Wish& wish, Contenders& out) {
  if (!wish.has("MJ")) return;
  out.push_back(std::make_unique<MultiJaggedContender>(Setting{"Zoltan2", "MJ", kPartition, 0}, wish.owners));
}

}  // namespace rcb::bench
