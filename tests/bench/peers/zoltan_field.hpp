// This rank's particles as Zoltan sees them through its callbacks, and its calls on them.
#pragma once

#include <algorithm>
#include <array>
#include <cstring>
#include <string>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <zoltan.h>

#include "common/particles/particle_set.hpp"
#include "tests/bench/peers/zoltan_parts.hpp"

namespace rcb::bench {

class ZoltanField {
 public:
  ZoltanField(const ZoltanField&) = delete;
  ZoltanField& operator=(const ZoltanField&) = delete;

 protected:
  ZoltanField() = default;
  ~ZoltanField() { destroy(); }

  void release_lists() {
    import_.release();
    export_.release();
  }
  void destroy() {
    if (zoltan_ == nullptr) return;
    release_lists();
    Zoltan_Destroy(&zoltan_);
  }
  // set_zoltan(), and the callbacks. Collective.
  Status create(const std::string& method, int parts, const std::vector<std::pair<const char*, const char*>>& more) {
    destroy();
    zoltan_ = Zoltan_Create(MPI_COMM_WORLD);
    if (zoltan_ == nullptr) return {Code::internal, "Zoltan_Create failed"};
    MPI_Comm_rank(MPI_COMM_WORLD, &rank_);
    if (Status status = set_zoltan(zoltan_, method, parts, more); !status.ok()) return status;
    Zoltan_Set_Num_Obj_Fn(zoltan_, count_of, this);
    Zoltan_Set_Obj_List_Fn(zoltan_, list_of, this);
    Zoltan_Set_Num_Geom_Fn(zoltan_, dims_of, this);
    Zoltan_Set_Geom_Multi_Fn(zoltan_, positions_of, this);
    Zoltan_Set_Obj_Size_Multi_Fn(zoltan_, zoltan_sizes, this);
    Zoltan_Set_Pack_Obj_Multi_Fn(zoltan_, pack, this);
    Zoltan_Set_Mid_Migrate_PP_Fn(zoltan_, remove_exports, this);
    Zoltan_Set_Unpack_Obj_Multi_Fn(zoltan_, unpack, this);
    return {};
  }

  // New cuts; the lists say what they move. Collective.
  Status find_cuts() {
    int changes = 0, gid_entries = 1, lid_entries = 1;
    return status_of("Zoltan_LB_Partition",
                     Zoltan_LB_Partition(zoltan_, &changes, &gid_entries, &lid_entries, &import_.count, &import_.global,
                                         &import_.local, &import_.rank, &import_.part, &export_.count, &export_.global,
                                         &export_.local, &export_.rank, &export_.part));
  }
  // What they move, by their lists. Collective.
  Status migrate_by_lists() {
    return status_of("Zoltan_Migrate",
                     Zoltan_Migrate(zoltan_, import_.count, import_.global, import_.local, import_.rank, import_.part,
                                    export_.count, export_.global, export_.local, export_.rank, export_.part));
  }
  static Status status_of(const char* call, int result) {
    return zoltan_failed(result) ? Status(Code::internal, fmt::format("{} returned {}", call, result)) : Status{};
  }

  std::size_t axes() const { return static_cast<std::size_t>(held_.dims); }
  void resize(std::size_t count) {
    for (std::size_t a = 0; a < axes(); ++a) at_[a].resize(count);
    ids_.resize(count);
    part_.resize(count);
  }
  void show_own() {
    for (std::size_t a = 0; a < axes(); ++a) held_.position[a] = at_[a].data();
    held_.id = ids_.data();
    held_.count = ids_.size();
  }

  Zoltan_Struct* zoltan_ = nullptr;
  int rank_ = 0;
  particles::ParticleView held_;  // what the callbacks show: somebody's, or, after show_own(), these
  std::array<std::vector<double>, 3> at_;
  std::vector<particles::Id> ids_;
  std::vector<std::int32_t> part_;
  ZoltanLists import_;
  ZoltanLists export_;

 private:
  static ZoltanField& self(void* data) { return *static_cast<ZoltanField*>(data); }
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
      const ZoltanCargo cargo{me.held_.point(i), me.part_[i]};
      std::memcpy(buffer + offset[k], &cargo, sizeof cargo);
    }
    *error = ZOLTAN_OK;
  }
  static void remove_exports(void* data, int, int, int, ZOLTAN_ID_PTR, ZOLTAN_ID_PTR, int*, int*, int count,
                             ZOLTAN_ID_PTR, ZOLTAN_ID_PTR local, int* rank, int*, int* error) {
    auto& me = self(data);
    *error = ZOLTAN_OK;
    std::size_t first = me.part_.size();
    for (int k = 0; k < count; ++k)
      if (rank[k] != me.rank_) {
        me.part_[local[k]] = -1;
        first = std::min<std::size_t>(first, local[k]);
      }
    std::size_t kept = first;
    for (std::size_t i = first; i < me.part_.size(); ++i) {
      if (me.part_[i] < 0) continue;
      for (std::size_t a = 0; a < me.axes(); ++a) me.at_[a][kept] = me.at_[a][i];
      me.ids_[kept] = me.ids_[i];
      me.part_[kept++] = me.part_[i];
    }
    me.resize(kept);
    me.show_own();
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
};

}  // namespace rcb::bench
