// Zoltan's RCB, RIB and HSFC at the fastest settings found: RETURN_LISTS=ALL, REMAP=0, CHECK_GEOM=0, and no cuts
// kept unless owners will be asked.
// IMBALANCE_TOL changes neither their answers nor their time (tried from 1 to 2), so each runs once.
// Without a part callback Zoltan takes the rank's number for the part of its particles, and its lists leave out those
// that stay so.
#include <algorithm>
#include <array>
#include <cstring>

#include <fmt/format.h>
#include <zoltan.h>

#include "tests/bench/peers/contender.hpp"
#include "tests/bench/peers/zoltan_parts.hpp"

namespace rcb::bench {
namespace {

class ZoltanContender final : public Contender {
 public:
  ZoltanContender(Setting setting, bool owners) : Contender(std::move(setting)), keep_cuts_(owners) {}
  ~ZoltanContender() override { destroy(); }

  Status prepare(const Problem& problem) override {
    destroy();
    problem_ = problem;
    zoltan_ = Zoltan_Create(MPI_COMM_WORLD);
    if (zoltan_ == nullptr) return {Code::internal, "Zoltan_Create failed"};
    MPI_Comm_rank(MPI_COMM_WORLD, &rank_);
    if (Status status = set_zoltan(zoltan_, setting().method, problem.parts, {{"KEEP_CUTS", keep_cuts_ ? "1" : "0"}});
        !status.ok())
      return status;
    Zoltan_Set_Num_Obj_Fn(zoltan_, count_of, this);
    Zoltan_Set_Obj_List_Fn(zoltan_, list_of, this);
    Zoltan_Set_Num_Geom_Fn(zoltan_, dims_of, this);
    Zoltan_Set_Geom_Multi_Fn(zoltan_, positions_of, this);
    Zoltan_Set_Obj_Size_Multi_Fn(zoltan_, zoltan_sizes, this);
    Zoltan_Set_Pack_Obj_Multi_Fn(zoltan_, pack, this);
    Zoltan_Set_Mid_Migrate_PP_Fn(zoltan_, remove_exports, this);
    Zoltan_Set_Unpack_Obj_Multi_Fn(zoltan_, unpack, this);
    held_ = problem.particles;
    return {};
  }

  void reset() override {
    import_.release();
    export_.release();
    if (!migrates()) return;
    const auto& from = problem_.particles;
    for (std::size_t a = 0; a < axes(); ++a) at_[a].assign(from.position[a], from.position[a] + from.count);
    ids_.assign(from.id, from.id + from.count);
    part_.clear();
    show_own();
  }

  Status run() override {
    int changes = 0, gid_entries = 1, lid_entries = 1;
    int result = Zoltan_LB_Partition(zoltan_, &changes, &gid_entries, &lid_entries, &import_.count, &import_.global,
                                     &import_.local, &import_.rank, &import_.part, &export_.count, &export_.global,
                                     &export_.local, &export_.rank, &export_.part);
    if (zoltan_failed(result)) return {Code::internal, fmt::format("Zoltan_LB_Partition returned {}", result)};
    if (!migrates()) return {};
    fill_parts();
    result = Zoltan_Migrate(zoltan_, import_.count, import_.global, import_.local, import_.rank, import_.part,
                            export_.count, export_.global, export_.local, export_.rank, export_.part);
    if (zoltan_failed(result)) return {Code::internal, fmt::format("Zoltan_Migrate returned {}", result)};
    return {};
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
  std::size_t axes() const { return static_cast<std::size_t>(problem_.particles.dims); }

  void destroy() {
    if (zoltan_ == nullptr) return;
    import_.release();
    export_.release();
    Zoltan_Destroy(&zoltan_);
  }

  void fill_parts() {
    part_.assign(held_.count, rank_);
    for (int k = 0; k < export_.count; ++k) part_[export_.local[k]] = export_.part[k];
  }

  void show_own() {
    for (std::size_t a = 0; a < axes(); ++a) held_.position[a] = at_[a].data();
    held_.id = ids_.data();
    held_.count = ids_.size();
  }

  // Zoltan's callbacks.
  static ZoltanContender& self(void* data) { return *static_cast<ZoltanContender*>(data); }
  static int count_of(void* data, int* error) {
    *error = ZOLTAN_OK;
    return static_cast<int>(self(data).held_.count);
  }
  static int dims_of(void* data, int* error) {
    *error = ZOLTAN_OK;
    return self(data).held_.dims;
  }
  static void list_of(void* data, int, int, ZOLTAN_ID_PTR global, ZOLTAN_ID_PTR local, int, float*, int* error) {
    const auto& held = self(data).held_;
    for (std::size_t i = 0; i < held.count; ++i) {
      global[i] = static_cast<ZOLTAN_ID_TYPE>(held.id[i]);
      local[i] = static_cast<ZOLTAN_ID_TYPE>(i);
    }
    *error = ZOLTAN_OK;
  }
  static void positions_of(void* data, int, int, int count, ZOLTAN_ID_PTR, ZOLTAN_ID_PTR local, int dims, double* out,
                           int* error) {
    const auto& held = self(data).held_;
    for (int k = 0; k < count; ++k)
      for (int a = 0; a < dims; ++a) *out++ = held.position[static_cast<std::size_t>(a)][local[k]];
    *error = ZOLTAN_OK;
  }
  static void pack(void* data, int, int, int count, ZOLTAN_ID_PTR, ZOLTAN_ID_PTR local, int*, int*, int* offset,
                   char* buffer, int* error) {
    const auto& me = self(data);
    for (int k = 0; k < count; ++k) {
      const std::size_t i = local[k];
      ZoltanCargo cargo{me.held_.point(i), me.part_[i]};
      std::memcpy(buffer + offset[k], &cargo, sizeof cargo);
    }
    *error = ZOLTAN_OK;
  }
  static void remove_exports(void* data, int, int, int, ZOLTAN_ID_PTR, ZOLTAN_ID_PTR, int*, int*, int count,
                             ZOLTAN_ID_PTR, ZOLTAN_ID_PTR local, int* rank, int*, int* error) {
    auto& me = self(data);
    for (int k = 0; k < count; ++k)
      if (rank[k] != me.rank_) me.part_[local[k]] = -1;
    std::size_t kept = 0;
    for (std::size_t i = 0; i < me.part_.size(); ++i) {
      if (me.part_[i] < 0) continue;
      for (std::size_t a = 0; a < me.axes(); ++a) me.at_[a][kept] = me.at_[a][i];
      me.ids_[kept] = me.ids_[i];
      me.part_[kept++] = me.part_[i];
    }
    me.resize(kept);
    *error = ZOLTAN_OK;
  }
  static void unpack(void* data, int, int count, ZOLTAN_ID_PTR global, int*, int* offset, char* buffer, int* error) {
    auto& me = self(data);
    const std::size_t old = me.part_.size();
    me.resize(old + static_cast<std::size_t>(count));
    for (int k = 0; k < count; ++k) {
      ZoltanCargo cargo;
      std::memcpy(&cargo, buffer + offset[k], sizeof cargo);
      const std::size_t i = old + static_cast<std::size_t>(k);
      for (std::size_t a = 0; a < me.axes(); ++a) me.at_[a][i] = cargo.at[a];
      me.ids_[i] = static_cast<particles::Id>(global[k]);
      me.part_[i] = static_cast<std::int32_t>(cargo.part);
    }
    me.show_own();
    *error = ZOLTAN_OK;
  }
  void resize(std::size_t count) {
    for (std::size_t a = 0; a < axes(); ++a) at_[a].resize(count);
    ids_.resize(count);
    part_.resize(count);
  }

  bool keep_cuts_;
  Problem problem_;
  Zoltan_Struct* zoltan_ = nullptr;
  int rank_ = 0;
  particles::ParticleView held_;  // what the callbacks show: the problem's, or this one's own where it migrates
  std::array<std::vector<double>, 3> at_;
  std::vector<particles::Id> ids_;
  std::vector<std::int32_t> part_;
  ZoltanLists import_;
  ZoltanLists export_;
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
