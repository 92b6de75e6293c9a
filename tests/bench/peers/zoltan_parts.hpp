// What every use of Zoltan here has in common: its settings, its lists, what travels with a particle.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <zoltan.h>

#include "common/base/status.hpp"

namespace rcb::bench {

struct ZoltanLists {
  int count = 0;
  ZOLTAN_ID_PTR global = nullptr;
  ZOLTAN_ID_PTR local = nullptr;
  int* rank = nullptr;
  int* part = nullptr;

  void release() {
    Zoltan_LB_Free_Part(&global, &local, &rank, &part);
    count = 0;
  }
};

// Besides its id.
struct ZoltanCargo {
  std::array<double, 3> at;
  std::int64_t part;
};

inline bool zoltan_failed(int result) { return result != ZOLTAN_OK && result != ZOLTAN_WARN; }

// Its callback for the sizes of particles.
inline void zoltan_sizes(void*, int, int, int count, ZOLTAN_ID_PTR, ZOLTAN_ID_PTR, int* sizes, int* error) {
  std::fill_n(sizes, count, static_cast<int>(sizeof(ZoltanCargo)));
  *error = ZOLTAN_OK;
}

// The fastest settings found, and `more`.
inline Status set_zoltan(Zoltan_Struct* zoltan, const std::string& method, int parts,
                         const std::vector<std::pair<const char*, const char*>>& more) {
  const std::string number = std::to_string(parts);
  std::vector<std::pair<const char*, const char*>> parameters{
      {"DEBUG_LEVEL", "0"},      {"LB_METHOD", method.c_str()},
      {"NUM_GID_ENTRIES", "1"},  {"NUM_LID_ENTRIES", "1"},
      {"OBJ_WEIGHT_DIM", "0"},   {"NUM_GLOBAL_PARTS", number.c_str()},
      {"RETURN_LISTS", "ALL"},   {"REMAP", "0"},
      {"CHECK_GEOM", "0"},       {"IMBALANCE_TOL", "1.0"},
      {"AUTO_MIGRATE", "FALSE"}, {"MIGRATE_ONLY_PROC_CHANGES", "1"}};
  parameters.insert(parameters.end(), more.begin(), more.end());
  // HSFC knows no CHECK_GEOM; a parameter unknown to a method is ignored with a warning's code.
  for (const auto& [name, value] : parameters)
    if (Zoltan_Set_Param(zoltan, name, value) == ZOLTAN_FATAL)
      return {Code::internal, fmt::format("Zoltan refused {}={}", name, value)};
  return {};
}

}  // namespace rcb::bench
