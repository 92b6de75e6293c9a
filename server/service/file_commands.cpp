// Files that the ranks read and write themselves, all at the same time: as in the paper, where every rank loads its
// own points and writes its own output.
#include <algorithm>
#include <array>
#include <cstring>
#include <filesystem>
#include <functional>
#include <limits>
#include <numeric>

#include <fmt/format.h>

#include "common/base/text.hpp"
#include "common/io/output_file.hpp"
#include "common/io/points.hpp"
#include "common/io/roots.hpp"
#include "common/plan/plan.hpp"
#include "common/wire/limits.hpp"
#include "server/service/collective.hpp"
#include "server/service/step.hpp"

namespace rcb::service {
namespace {

constexpr std::size_t kPrefixBytesMax = 64;
constexpr std::size_t kListedBytesMax = 1U << 20U;  // of the paths in an answer

struct LoadRequest {
  std::string path;
  io::ReadOptions options;
  std::int64_t step = 0;
};

// A path on the machine of the ranks, whose working directory is nobody's business.
Result<std::string> absolute_path_field(const wire::Json& request, const char* name) {
  auto path = wire::string_field(request, name);
  if (path.ok() && !std::filesystem::path(*path).is_absolute())
    return Status(Code::invalid_argument, fmt::format("field '{}': \"{}\" is not an absolute path", name, *path),
                  "the service doesn't work in your directory");
  return path;
}

Result<LoadRequest> read_load(const wire::Json& request) {
  LoadRequest load;
  const auto path = absolute_path_field(request, "path");
  if (!path.ok()) return path.status();
  load.path = path.value();
  const auto dims = wire::integer_field_or(request, "dims", 1, 3, 0);
  if (!dims.ok()) return dims.status();
  load.options.dims = static_cast<int>(dims.value());
  if (request.contains("weights") && !request["weights"].is_null()) {
    const auto weights = wire::string_field(request, "weights");
    if (!weights.ok()) return weights.status();
    load.options.weights = weights.value();
  }
  const auto step = wire::integer_field_or(request, "step", 0, wire::kStepMax, 0);
  if (!step.ok()) return step.status();
  load.step = step.value();
  return load;
}

// The slices of all ranks must make one set. Collective.
struct Slices {
  std::uint64_t total = 0;
  std::uint64_t first_row = 0;  // of this rank
  bool ids = false;
  bool weights = false;
  int dims = 0;
  bool one_file = true;  // all have read the same file in the same state
};

Slices join_slices(partition::Comm& comm, const io::Points& points) {
  const std::array<std::uint64_t, 7> mine{points.count,
                                          points.id.empty() ? 0U : 1U,
                                          points.weight.empty() ? 0U : 1U,
                                          points.count == 0 ? 0U : static_cast<std::uint64_t>(points.dims),
                                          points.file.inode,
                                          points.file.size,
                                          static_cast<std::uint64_t>(points.file.changed_nanoseconds)};
  std::vector<std::byte> all;
  std::vector<std::size_t> sizes;
  comm.all_gather(std::as_bytes(std::span(mine)), all, sizes);
  Slices slices;
  for (std::size_t r = 0; r < static_cast<std::size_t>(comm.size()); ++r) {
    std::array<std::uint64_t, 7> theirs{};
    std::memcpy(theirs.data(), all.data() + r * sizeof theirs, sizeof theirs);
    if (r < static_cast<std::size_t>(comm.rank())) slices.first_row += theirs[0];
    slices.total += theirs[0];
    slices.ids = slices.ids || theirs[1] != 0;
    slices.weights = slices.weights || theirs[2] != 0;
    slices.dims = std::max(slices.dims, static_cast<int>(theirs[3]));
    slices.one_file =
        slices.one_file && std::memcmp(theirs.data() + 4, all.data() + 4 * sizeof theirs[0], 3 * sizeof theirs[0]) == 0;
  }
  return slices;
}

particles::ParticleSet particles_of(io::Points points, const Slices& slices, int dims) {
  particles::ParticleSet set;
  set.dims = dims;
  set.has_weights = slices.weights;
  for (std::size_t a = 0; a < points.position.size() && a < static_cast<std::size_t>(dims); ++a)
    set.position[a].assign(points.position[a]);
  if (slices.weights) set.weight.assign(points.weight);
  if (slices.ids) {
    set.id.assign(points.id);
  } else {
    set.id.resize(points.count);
    std::iota(set.id.begin(), set.id.end(), static_cast<particles::Id>(slices.first_row));
  }
  return set;
}

bool ids_are_rows(partition::Comm& comm, const particles::ParticleSet& set, std::uint64_t first_row) {
  bool rows = true;
  for (std::size_t i = 0; i < set.count() && rows; ++i) rows = set.id[i] == static_cast<particles::Id>(first_row + i);
  return partition::agree(comm, rows);
}

Response load(Context& context, const wire::Json& request) {
  const auto found = find_scene(context, request);
  if (!found.ok()) return failed(found.status());
  Scene& scene = *found.value();
  auto load = read_load(request);
  if (!load.ok()) return failed(load.status());
  if (scene.pushed)
    return failed({Code::invalid_argument, fmt::format("scene '{}' has positions already", scene.name),
                   "load is for a scene's first positions; push the file instead"});
  if (load->options.dims == 0) load->options.dims = scene.options.dims;
  load->options.below = &context.roots;
  const double start = context.clock.seconds();
  partition::Comm& comm = context.comm;
  auto points = io::read_points_slice(load->path, load->options, comm.rank(), comm.size());
  if (Status status = agree_status(comm, points.status()); !status.ok()) return failed(std::move(status));
  const Slices slices = join_slices(comm, points.value());
  if (!slices.one_file)
    return failed({Code::io_error,
                   fmt::format("{}: was changed while it was read, or isn't the same for all ranks", load->path),
                   "wait until it is written, then try again"});
  if (slices.total > 0 && slices.dims != scene.options.dims)
    return failed({Code::invalid_argument, fmt::format("{} has {} dimension(s), scene '{}' has {}", load->path,
                                                       slices.dims, scene.name, scene.options.dims)});
  Staged staged;
  staged.n = slices.total;
  staged.arrays = particles_of(std::move(points).value(), slices, scene.options.dims);
  if (Status status = context.check_time(); !status.ok()) return failed(std::move(status));
  if (Status status = check_values(comm, staged.arrays.view(), true, slices.first_row); !status.ok())
    return failed(std::move(status));
  if (slices.ids) {
    if (const auto twin = duplicate_id(comm, staged.arrays.id.span()))
      return failed({Code::invalid_argument, fmt::format("{}: id {} occurs more than once", load->path, *twin),
                     "ids must be distinct"});
    staged.ids = !ids_are_rows(comm, staged.arrays, slices.first_row);
  }
  // From here on it is done, whatever the time: the commit can't be left halfway.
  if (Status status = context.check_time(); !status.ok()) return failed(std::move(status));
  staged.seconds = context.clock.seconds() - start;
  PushRequest push;
  push.session = "load";
  push.step = load->step;
  push.n = staged.n;
  const StepReport report = commit(context, scene, staged, push, nullptr);
  return done({{"report", to_json(report)},
               {"plan", {{"version", scene.plan_version}, {"checksum", wire::hex64(scene.plan_checksum)}}}});
}

// This rank's particles, part after part.
struct ByPart {
  std::vector<std::uint64_t> start;  // of each of this rank's parts, and the end
  std::vector<std::uint64_t> slot;
};

ByPart slots_by_part(const Scene& scene, std::int64_t first, std::int64_t last) {
  ByPart by;
  by.start.assign(static_cast<std::size_t>(last - first) + 1, 0);
  for (const std::int32_t part : scene.part) ++by.start[static_cast<std::size_t>(part - first) + 1];
  std::partial_sum(by.start.begin(), by.start.end(), by.start.begin());
  by.slot.resize(scene.part.size());
  std::vector<std::uint64_t> next(by.start.begin(), by.start.end() - 1);
  for (std::size_t i = 0; i < scene.part.size(); ++i)
    by.slot[next[static_cast<std::size_t>(scene.part[i] - first)]++] = i;
  return by;
}

// The particles in these slots as CSV.
Status write_part(const Scene& scene, std::span<const std::uint64_t> slots, const io::Folder& folder,
                  const std::string& name) {
  auto file = io::OutputFile::create_in(folder, name);
  if (!file.ok()) return file.status();
  particles::ParticleSet chosen;
  chosen.dims = scene.options.dims;
  chosen.has_weights = scene.particles.has_weights;
  for (const std::uint64_t i : slots) {
    for (std::size_t a = 0; a < static_cast<std::size_t>(chosen.dims); ++a)
      chosen.position[a].push_back(scene.particles.position[a][i]);
    chosen.id.push_back(scene.particles.id[i]);
    if (chosen.has_weights) chosen.weight.push_back(scene.particles.weight[i]);
  }
  const auto view = chosen.view();
  return io::write_csv(std::move(*file), chosen.dims,
                       std::span(view.position.data(), static_cast<std::size_t>(chosen.dims)), view.count, view.id,
                       view.weight);
}

// What the names of the files begin with: part of one name, and fit for any terminal that lists it.
Result<std::string> read_prefix(const wire::Json& request) {
  if (!request.contains("prefix") || request["prefix"].is_null()) return std::string("part");
  const auto prefix = wire::string_field(request, "prefix", kPrefixBytesMax);
  if (!prefix.ok()) return prefix.status();
  if (prefix->empty() || *prefix == "." || *prefix == ".." || prefix->find('/') != std::string::npos ||
      has_controls(*prefix))
    return Status(Code::invalid_argument,
                  fmt::format("field 'prefix': \"{}\" can't begin the name of a file", escape_controls(*prefix)),
                  fmt::format("give 1 to {} bytes without slash and control characters", kPrefixBytesMax));
  return prefix;
}

// Each rank writes the files of its parts. All look at the time after as many parts. Collective.
Status write_own_parts(Context& context, const Scene& scene, const io::Folder& folder,
                       const std::function<std::string(std::int64_t)>& name_of) {
  constexpr std::int64_t kBetween = 16;
  const int ranks = context.comm.size();
  const std::int64_t begin = plan::part_begin(context.comm.rank(), scene.options.parts, ranks);
  const std::int64_t end = plan::part_begin(context.comm.rank() + 1, scene.options.parts, ranks);
  const std::int64_t most = (scene.options.parts + ranks - 1) / ranks;  // parts of a rank
  const ByPart by = slots_by_part(scene, begin, end);
  Status written;
  for (std::int64_t k = 0; k < most; ++k) {
    if (k % kBetween == 0)
      if (Status status = context.check_time(); !status.ok()) return status;
    if (begin + k >= end || !written.ok()) continue;
    const auto at = static_cast<std::size_t>(k);
    written = write_part(scene, std::span(by.slot).subspan(by.start[at], by.start[at + 1] - by.start[at]), folder,
                         name_of(begin + k));
  }
  return agree_status(context.comm, written);
}

Response write_parts(Context& context, const wire::Json& request) {
  const auto found = find_pushed_scene(context, request);
  if (!found.ok()) return failed(found.status());
  const Scene& scene = *found.value();
  const auto directory = absolute_path_field(request, "directory");
  if (!directory.ok()) return failed(directory.status());
  const auto prefix = read_prefix(request);
  if (!prefix.ok()) return failed(prefix.status());

  const int parts = scene.options.parts;
  const auto name_of = [&](std::int64_t part) {
    return fmt::format("{}-{:0{}}.csv", prefix.value(), part, std::to_string(parts - 1).size());
  };
  const auto folder = context.roots.make_folder(*directory);
  Status made = agree_status(context.comm, folder.status());
  if (made.ok()) made = write_own_parts(context, scene, *folder, name_of);
  if (!made.ok()) return failed(std::move(made));
  if (!context.root()) return {};
  const auto path_of = [&](std::int64_t part) { return (std::filesystem::path(*directory) / name_of(part)).string(); };
  const bool listed = static_cast<std::size_t>(parts) * path_of(0).size() <= kListedBytesMax;
  wire::Json files = listed ? wire::Json::array() : wire::Json(nullptr);
  for (int p = 0; p < parts && listed; ++p) files.push_back(path_of(p));
  return done({{"files", std::move(files)}, {"first", path_of(0)}, {"last", path_of(parts - 1)}});
}

constexpr Command kCommands[] = {{"load", load}, {"write_parts", write_parts, true}};

}  // namespace

std::span<const Command> file_commands() { return kCommands; }

}  // namespace rcb::service
