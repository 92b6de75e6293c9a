#include "client/cli/fetched.hpp"

#include <fmt/format.h>

#include "common/base/paths.hpp"
#include "common/io/points.hpp"

namespace rcb::cli {

Result<Fetched> fetched(const client::Reply& reply) {
  const client::Array* id = reply.find("id");
  const client::Array* part = reply.find("part");
  const client::Array* weight = reply.find("w");
  if (id == nullptr || part == nullptr || id->dtype != "<i8" || part->dtype != "<i4")
    return Status(Code::protocol_error, "the answer to fetch lacks its ids or parts");
  Fetched set{{}, id->i8(), {}, part->i4()};
  for (const char* name : {"x", "y", "z"})
    if (const client::Array* axis = reply.find(name); axis != nullptr && axis->dtype == "<f8")
      set.axes.push_back(axis->f8());
  if (weight != nullptr && weight->dtype == "<f8") set.weight = weight->f8();
  bool equal = !set.axes.empty() && set.part.size() == set.id.size();
  for (const auto& axis : set.axes) equal = equal && axis.size() == set.id.size();
  if (!equal || (!set.weight.empty() && set.weight.size() != set.id.size()))
    return Status(Code::protocol_error, "the arrays of fetch differ in length");
  return set;
}

Status write_part_files(const Fetched& set, int parts, const std::string& directory, nlohmann::ordered_json& files) {
  // Rows sorted by part, each part's in id order: one pass to count, one to place.
  std::vector<std::size_t> begin(static_cast<std::size_t>(parts) + 1);
  for (const std::int32_t part : set.part) {
    if (part < 0 || part >= parts) return {Code::protocol_error, fmt::format("part {} of {}", part, parts)};
    ++begin[static_cast<std::size_t>(part) + 1];
  }
  for (std::size_t p = 1; p < begin.size(); ++p) begin[p] += begin[p - 1];
  std::vector<std::size_t> row(set.part.size());
  std::vector<std::size_t> next(begin.begin(), begin.end() - 1);
  for (std::size_t i = 0; i < row.size(); ++i) row[next[static_cast<std::size_t>(set.part[i])]++] = i;
  for (int p = 0; p < parts; ++p) {
    const std::size_t from = begin[static_cast<std::size_t>(p)];
    const std::size_t count = begin[static_cast<std::size_t>(p) + 1] - from;
    std::vector<std::vector<double>> axes(set.axes.size(), std::vector<double>(count));
    std::vector<std::int64_t> id(count);
    std::vector<double> weight(set.weight.empty() ? 0 : count);
    for (std::size_t k = 0; k < count; ++k) {
      const std::size_t i = row[from + k];
      for (std::size_t a = 0; a < axes.size(); ++a) axes[a][k] = set.axes[a][i];
      id[k] = set.id[i];
      if (!weight.empty()) weight[k] = set.weight[i];
    }
    std::vector<const double*> position;
    for (const auto& axis : axes) position.push_back(axis.data());
    const std::size_t digits = std::to_string(parts - 1).size();
    const std::string path = join_path(directory, fmt::format("part-{:0{}}.csv", p, digits));
    if (Status status = io::write_csv(path, static_cast<int>(axes.size()), position, count, id.data(),
                                      set.weight.empty() ? nullptr : weight.data());
        !status)
      return status;
    files.push_back(path);
  }
  return {};
}

}  // namespace rcb::cli
