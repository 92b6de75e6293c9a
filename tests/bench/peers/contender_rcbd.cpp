// Ours: the engine's partition() as the service calls it, and the service's own hand-over for `partition+migrate`.
#include <array>

#include "common/partition/partition.hpp"
#include "server/service/step/exchange.hpp"
#include "tests/bench/peers/contender.hpp"

namespace rcb::bench {
namespace {

using cuts::Method;
using partition::PartitionOptions;

class RcbdContender final : public Contender {
 public:
  RcbdContender(Setting setting, comm::Comm& comm, Method method)
      : Contender(std::move(setting)), comm_(comm), method_(method) {}

  Status prepare(const Problem& problem) override {
    const int band = cuts::band_axis(method_).value_or(0);
    if (band >= problem.particles.dims) return {Code::unsupported, "bands along an axis that there isn't"};
    problem_ = problem;
    options_ = PartitionOptions{};
    options_.method = method_;
    options_.parts = problem.parts;
    options_.cut_tolerance = setting().cut_tolerance;
    return {};
  }

  void reset() override {
    result_ = partition::PartitionResult{};
    if (!migrates()) return;
    scene_ = service::Scene{};
    scene_.options.parts = problem_.parts;
    scene_.options.dims = problem_.particles.dims;
    scene_.n = problem_.n;
    const auto& from = problem_.particles;
    scene_.particles.dims = from.dims;
    for (std::size_t a = 0; a < static_cast<std::size_t>(from.dims); ++a)
      scene_.particles.position[a].assign({from.position[a], from.count});
    scene_.particles.id.assign({from.id, from.count});
  }

  Status run() override {
    auto result = partition::partition(comm_, migrates() ? scene_.particles.view() : problem_.particles, options_);
    if (!result) return result.status();
    result_ = std::move(*result);
    if (migrates()) {
      scene_.part.swap(result_.part);
      service::send_strangers(comm_, scene_, true);
    }
    return {};
  }

  Answer answer() override {
    Answer answer;
    const auto& part = migrates() ? scene_.part : result_.part;
    answer.part.assign(part.begin(), part.end());
    answer.hash = result_.tree.hash();
    answer.cost = result_.cost;
    return answer;
  }

  std::optional<std::vector<std::int32_t>> owners() override {
    const auto& particles = problem_.particles;
    std::vector<std::int32_t> owners(particles.count);
    for (std::size_t i = 0; i < owners.size(); ++i)
      owners[i] = result_.tree.part_of(particles.point(i), particles.id[i]);
    return owners;
  }

 private:
  bool migrates() const { return setting().work == kPartitionMigrate; }

  comm::Comm& comm_;
  Method method_;
  Problem problem_;
  PartitionOptions options_;
  partition::PartitionResult result_;
  service::Scene scene_;
};

}  // namespace

bool Wish::has(const std::string& method) const {
  return std::find(methods.begin(), methods.end(), method) != methods.end();
}

void add_rcbd(comm::Comm& comm, const Wish& wish, Contenders& out) {
  for (const Method method : {Method::rcb, Method::bands_x, Method::bands_y, Method::bands_z}) {
    const std::string name(cuts::method_name(method));
    if (!wish.has(name)) continue;
    for (const double tolerance : wish.cut_tolerances)
      out.push_back(std::make_unique<RcbdContender>(Setting{"rcbd", name, kPartition, tolerance}, comm, method));
  }
  if (wish.migrate && wish.has("rcb"))
    out.push_back(std::make_unique<RcbdContender>(Setting{"rcbd", "rcb", kPartitionMigrate, 0}, comm, Method::rcb));
}

}  // namespace rcb::bench
