// Zoltan's RCB, RIB and HSFC at the fastest settings found: RETURN_LISTS=ALL, REMAP=0, CHECK_GEOM=0, and no cuts
// kept unless owners will be asked.
// IMBALANCE_TOL changes neither their answers nor their time (tried from 1 to 2), so each runs once.
// Without a part callback Zoltan takes the rank's number for the part of its particles, and its lists leave out those
// that stay so.
#include "tests/bench/peers/contender.hpp"
#include "tests/bench/peers/zoltan_field.hpp"

namespace rcb::bench {
namespace {

class ZoltanContender final : public Contender, private ZoltanField {
 public:
  ZoltanContender(Setting setting, bool owners) : Contender(std::move(setting)), keep_cuts_(owners) {}

  Status prepare(const Problem& problem) override {
    problem_ = problem;
    held_ = problem.particles;
    return create(setting().method, problem.parts, {{"KEEP_CUTS", keep_cuts_ ? "1" : "0"}});
  }

  void reset() override {
    release_lists();
    if (!migrates()) return;
    const auto& from = problem_.particles;
    for (std::size_t a = 0; a < axes(); ++a) at_[a].assign(from.position[a], from.position[a] + from.count);
    ids_.assign(from.id, from.id + from.count);
    part_.clear();
    show_own();
  }

  Status run() override {
    if (Status status = find_cuts(); !status.ok() || !migrates()) return status;
    fill_parts();
    return migrate_by_lists();
  }

  Answer answer() override {
    if (!migrates()) fill_parts();
    Answer answer;
    answer.part = part_;
    return answer;
  }

  std::optional<std::vector<std::int32_t>> owners() override {
    if (!keep_cuts_) return std::nullopt;
    std::vector<std::int32_t> owners(problem_.particles.count, -1);
    for (std::size_t i = 0; i < owners.size(); ++i) {
      geometry::Point point = problem_.particles.point(i);
      int rank = -1;
      int part = -1;
      if (!zoltan_failed(Zoltan_LB_Point_PP_Assign(zoltan_, point.data(), &rank, &part))) owners[i] = part;
    }
    return owners;
  }

 private:
  bool migrates() const { return setting().work == kPartitionMigrate; }
  void fill_parts() {
    part_.assign(held_.count, rank_);
    for (int k = 0; k < export_.count; ++k) part_[export_.local[k]] = export_.part[k];
  }

  bool keep_cuts_;
  Problem problem_;
};

}  // namespace

void add_zoltan(const Wish& wish, Contenders& out) {
  float version = 0;
  Zoltan_Initialize(0, nullptr, &version);
  for (const char* method : {"RCB", "RIB", "HSFC"}) {
    if (!wish.has(method)) continue;
    out.push_back(std::make_unique<ZoltanContender>(Setting{"Zoltan", method, kPartition, 0}, wish.owners));
  }
  if (wish.migrate && wish.has("RCB"))
    out.push_back(std::make_unique<ZoltanContender>(Setting{"Zoltan", "RCB", kPartitionMigrate, 0}, false));
}

}  // namespace rcb::bench
