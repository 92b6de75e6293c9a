#include "client/cli/files/part_files.hpp"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>

#include <fmt/format.h>
#include <unistd.h>

#include "common/files/paths.hpp"
#include "common/io/points.hpp"

namespace rcb::cli {
namespace {

// A part's file, or "weight.npy", which an export writes only if the scene has weights.
bool is_export_name(const std::string& name) { return name == "weight.npy" || is_part_file_name(name); }

// An export writes three arrays at least. Where only some of them are there, another program has written them: the name
// of one, or nothing.
std::string array_of_others(const std::string& directory, const std::vector<std::string>& written) {
  std::string found;
  bool all = true;
  for (const char* name : {"positions.npy", "id.npy", "part.npy"}) {
    if (std::ranges::count(written, name) == 0) return {};
    const bool there = access(join_path(directory, name).c_str(), F_OK) == 0;
    if (there) found = name;
    all &= there;
  }
  return all ? "" : found;
}

bool same_kind(const std::string& name, const std::vector<std::string>& written) {
  return std::any_of(written.begin(), written.end(),
                     [&name](const std::string& other) { return other.ends_with(name.substr(name.rfind('.'))); });
}

template <typename T>
std::vector<T> chosen(std::span<const T> values, std::span<const std::size_t> rows) {
  std::vector<T> list;
  list.reserve(rows.size());
  for (const std::size_t row : rows) list.push_back(values[row]);
  return list;
}

Status write_part(const Fetched& set, std::span<const std::size_t> rows, const std::string& path,
                  const Beside& beside) {
  auto file = io::OutputFile::create(path);
  if (!file) return file.status();
  const int dims = static_cast<int>(set.axes.size());
  io::CsvWriter writer(std::move(*file), dims, true, set.weight.has_value(), beside.names);
  std::vector<std::vector<double>> axes;
  std::vector<const double*> position;
  for (const auto& axis : set.axes) position.push_back(axes.emplace_back(chosen(axis, rows)).data());
  const auto weight = set.weight ? chosen(*set.weight, rows) : std::vector<double>();
  const auto cells = beside.cells.empty() ? beside.cells : chosen<std::string_view>(beside.cells, rows);
  if (Status status = writer.append(position, rows.size(), chosen(set.id, rows), weight, cells); !status) return status;
  return writer.commit();
}

}  // namespace

bool is_part_file_name(const std::string& name) {
  constexpr std::string_view kBegin = "part-", kEnd = ".csv";
  if (name.size() <= kBegin.size() + kEnd.size() || !name.starts_with(kBegin) || !name.ends_with(kEnd)) return false;
  return std::all_of(name.begin() + kBegin.size(), name.end() - kEnd.size(),
                     [](char c) { return c >= '0' && c <= '9'; });
}

std::vector<std::string> part_file_names(int parts) {
  std::vector<std::string> names;
  const std::size_t digits = std::to_string(parts - 1).size();
  for (int p = 0; p < parts; ++p) names.push_back(fmt::format("part-{:0{}}.csv", p, digits));
  return names;
}

Result<LeftoverFiles> LeftoverFiles::find(const std::string& directory, const std::vector<std::string>& written,
                                          bool replace) {
  std::vector<std::string> sorted = written, names;
  std::sort(sorted.begin(), sorted.end());
  std::error_code fault;
  for (const std::string& name : names_in(directory, fault))
    if (is_export_name(name) && same_kind(name, written) && !std::binary_search(sorted.begin(), sorted.end(), name) &&
        std::filesystem::is_regular_file(join_path(directory, name), fault))
      names.push_back(name);
  if (fault && fault != std::errc::no_such_file_or_directory)
    return Status(Code::io_error, fmt::format("{}: {}", directory, fault.message()));
  if (const std::string array = array_of_others(directory, written); !array.empty() && !replace)
    return Status(Code::already_exists, fmt::format("{} holds {}, and not by an export", directory, array),
                  "--replace overwrites it; or name another folder");
  LeftoverFiles left;
  std::sort(names.begin(), names.end());
  for (const std::string& name : names) left.paths_.push_back(join_path(directory, name));
  if (names.empty() || replace) return left;
  return Status(Code::already_exists,
                fmt::format("{} holds {}{}, which this partition doesn't have", directory, names.front(),
                            names.size() == 1 ? "" : fmt::format(" and {} more files", names.size() - 1)),
                "--replace removes them; or name another folder");
}

Status LeftoverFiles::remove() const {
  for (const std::string& path : paths_)
    if (unlink(path.c_str()) != 0 && errno != ENOENT)
      return {Code::io_error, fmt::format("{}: can't be removed: {}", path, std::strerror(errno))};
  return {};
}

Status write_part_files(const Fetched& set, int parts, const std::string& directory, const Beside& beside) {
  // Rows sorted by part, within a part by id: one pass to count, one to place.
  std::vector<std::size_t> begin(static_cast<std::size_t>(parts) + 1);
  for (const std::int32_t part : set.part) {
    if (part < 0 || part >= parts) return {Code::protocol_error, fmt::format("part {} of {}", part, parts)};
    ++begin[static_cast<std::size_t>(part) + 1];
  }
  for (std::size_t p = 1; p < begin.size(); ++p) begin[p] += begin[p - 1];
  std::vector<std::size_t> row(set.part.size());
  std::vector<std::size_t> next(begin.begin(), begin.end() - 1);
  for (std::size_t i = 0; i < row.size(); ++i) row[next[static_cast<std::size_t>(set.part[i])]++] = i;
  const std::vector<std::string> names = part_file_names(parts);
  for (std::size_t p = 0; p < names.size(); ++p) {
    const auto rows = std::span(row).subspan(begin[p], begin[p + 1] - begin[p]);
    if (Status status = write_part(set, rows, join_path(directory, names[p]), beside); !status) return status;
  }
  return {};
}

}  // namespace rcb::cli
