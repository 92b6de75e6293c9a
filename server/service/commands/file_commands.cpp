// Commands by which the ranks read and write files in parallel, as in the paper: every rank loads its own points and
// writes its own output.
#include <algorithm>
#include <array>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>

#include <fmt/format.h>

#include "common/base/text.hpp"
#include "common/io/files/output_file.hpp"
#include "common/io/files/roots.hpp"
#include "common/io/points.hpp"
#include "common/layout/layout.hpp"
#include "common/particles/by_part.hpp"
#include "common/wire/field_reader.hpp"
#include "common/wire/limits.hpp"
#include "server/service/commands/file_work.hpp"
#include "server/service/context/collective.hpp"
#include "server/service/step/step.hpp"

namespace rcb::service {
namespace {

constexpr std::size_t kPrefixBytesMax = 64;
constexpr std::size_t kListedBytesMax = 1U << 20U;  // of all paths listed in an answer

struct LoadRequest {
  std::string path;
  io::ReadOptions options;
  std::int64_t step = 0;
};

// A path on the ranks' machine; absolute, since clients don't know the service's working directory.
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
  wire::FieldReader fields(request);
  load.options.dims = static_cast<int>(fields.integer_or("dims", 1, 3, 0));
  if (fields.has("weights")) load.options.weights = fields.text("weights");
  load.options.columns = fields.texts("columns", 3);
  if (fields.has("ids")) load.options.ids = fields.text("ids");
  load.step = fields.integer_or("step", 0, wire::kStepMax, 0);
  if (!fields.ok()) return fields.status();
  return load;
}

// What the slices of all ranks, which must form one set, have in common; made by join_slices() (collective).
struct SliceTotals {
  std::uint64_t total = 0;
  std::uint64_t first_row = 0;  // of this rank's slice
  bool ids = false;
  bool weights = false;
  int dims = 0;
  bool one_file = true;  // all ranks have read the same file in the same state
};

SliceTotals join_slices(comm::Comm& comm, const io::Points& points) {
  struct Slice {
    std::uint64_t count;
    std::uint64_t ids;
    std::uint64_t weights;
    std::uint64_t dims;
    std::array<std::uint64_t, 3> file;
  };
  const Slice mine{points.count,
                   points.id.empty() ? 0U : 1U,
                   points.weight.empty() ? 0U : 1U,
                   points.count == 0 ? 0U : static_cast<std::uint64_t>(points.dims),
                   {points.file.inode, points.file.size, static_cast<std::uint64_t>(points.file.changed_nanoseconds)}};
  const auto all = comm::all_gather_values<Slice>(comm, std::span(&mine, 1)).values;
  SliceTotals slices;
  for (std::size_t r = 0; r < all.size(); ++r) {
    const Slice& theirs = all[r];
    if (r < static_cast<std::size_t>(comm.rank())) slices.first_row += theirs.count;
    slices.total += theirs.count;
    slices.ids = slices.ids || theirs.ids != 0;
    slices.weights = slices.weights || theirs.weights != 0;
    slices.dims = std::max(slices.dims, static_cast<int>(theirs.dims));
    slices.one_file = slices.one_file && theirs.file == all[0].file;
  }
  return slices;
}

// The points as a rank's particles; each array is freed once it is copied. Errors: too_large.
Result<particles::ParticleSet> particles_of(io::Points points, const SliceTotals& slices, int dims) {
  particles::ParticleSet set;
  set.dims = dims;
  set.has_weights = slices.weights;
  bool fits = set.id.try_reserve(points.count);
  const auto take = [&fits](auto& to, auto& from) {
    fits = fits && to.try_reserve(from.size());
    if (fits) to.assign(from);
    from = {};
  };
  for (std::size_t a = 0; a < points.position.size() && a < static_cast<std::size_t>(dims); ++a)
    take(set.position[a], points.position[a]);
  if (slices.weights) take(set.weight, points.weight);
  if (slices.ids) take(set.id, points.id);
  if (!fits)
    return Status(Code::too_large, fmt::format("no memory for {} particles", points.count),
                  "give the file to more ranks or a larger machine");
  if (!slices.ids) {
    set.id.resize(points.count);
    std::iota(set.id.begin(), set.id.end(), static_cast<particles::Id>(slices.first_row));
  }
  return set;
}

// Reads this rank's slice. Collective. Errors: those of finish().
Result<io::Points> read_slice(Context& context, const LoadRequest& load) {
  FileWork work(context.files);
  auto points = std::make_shared<std::optional<io::Points>>();
  work.run([load, points, roots = context.options.roots, &stop = work.stop(), rank = context.comm.rank(),
            ranks = context.comm.size()]() -> Status {
    io::ReadOptions options = load.options;
    options.below = roots.get();
    options.stop = &stop;
    auto read = io::read_points_slice(load.path, options, rank, ranks);
    if (read.ok()) points->emplace(std::move(*read));
    return read.status();
  });
  if (Status status = finish(context, work, [] { return false; }); !status.ok()) return status;
  return std::move(**points);
}

Response load(Context& context, Scene& scene, const wire::Json& request) {
  auto load = read_load(request);
  if (!load.ok()) return failed(load.status());
  if (scene.epoch > 0)
    return failed({Code::invalid_argument, fmt::format("scene '{}' has positions already", scene.name),
                   "load is for a scene's first positions; push the file instead"});
  if (load->options.dims == 0) load->options.dims = scene.options.dims;
  load->options.bytes_max = context.options.bulk_bytes_max;
  const double start = context.clock.seconds();
  comm::Comm& comm = context.comm;
  auto points = read_slice(context, *load);
  if (!points.ok()) return failed(points.status());
  const SliceTotals slices = join_slices(comm, points.value());
  if (!slices.one_file)
    return failed({Code::io_error,
                   fmt::format("{}: was changed while it was read, or isn't the same for all ranks", load->path),
                   "wait until it is written, then try again"});
  if (slices.total == 0)
    return failed({Code::invalid_argument, load->path + ": holds no points",
                   "load a file that holds some; was this one written to its end?"});
  if (slices.dims != scene.options.dims)
    return failed({Code::invalid_argument, fmt::format("{} has {} dimension(s), scene '{}' has {}", load->path,
                                                       slices.dims, scene.name, scene.options.dims)});
  PushRequest push;
  push.id.step = load->step;
  push.n = slices.total;
  push.ids = slices.ids;
  push.weights = slices.weights;
  push.way = api::Way::file;
  auto particles = particles_of(std::move(points).value(), slices, scene.options.dims);
  if (Status status = agree_status(comm, particles.status()); !status.ok()) return failed(std::move(status));
  if (Status status = context.check_time(); !status.ok()) return failed(std::move(status));
  auto staged = prepare_set(comm, scene, push, {.set = std::move(particles).value()});
  if (const Status& status = staged.status(); !status.ok())
    return failed({status.code(), fmt::format("{}: {}", load->path, status.message()), status.hint()});
  // Last look at the deadline: from here on the command runs to its end, since the commit can't be stopped halfway.
  if (Status status = context.check_time(); !status.ok()) return failed(std::move(status));
  staged->seconds = context.clock.seconds() - start;
  scene::Stepped stepped = commit(context, scene, *staged, push);
  Response response = done({{"report", to_json(stepped.report)}});
  if (context.root()) response.change = {scene.name, std::move(stepped)};
  return response;
}

// Particles copied for the thread that writes them.
particles::ParticleSet chosen(const Scene& scene, std::span<const std::size_t> slots) {
  particles::ParticleSet set;
  set.dims = scene.options.dims;
  set.has_weights = scene.particles.has_weights;
  for (const std::uint64_t i : slots) {
    for (std::size_t a = 0; a < static_cast<std::size_t>(set.dims); ++a)
      set.position[a].push_back(scene.particles.position[a][i]);
    set.id.push_back(scene.particles.id[i]);
    if (set.has_weights) set.weight.push_back(scene.particles.weight[i]);
  }
  return set;
}

// Particles of a part's file.
struct Piece {
  std::string name;  // of the file that it begins; empty: it goes on with the one before
  particles::ParticleSet particles;
  bool last = false;  // of its file
};

// This rank's files, written one after another, piece by piece. Lives on the thread that writes them.
class PartWriter {
 public:
  PartWriter(std::shared_ptr<const io::Roots> roots, std::string directory)
      : roots_(std::move(roots)), directory_(std::move(directory)) {}

  Status open() {
    auto folder = roots_->make_folder(directory_);
    if (!folder.ok()) return folder.status();
    folder_.emplace(std::move(*folder));
    return {};
  }
  Status write(const std::vector<Piece>& pieces) {
    Status written;
    for (std::size_t k = 0; k < pieces.size() && written.ok(); ++k) written = write_piece(pieces[k]);
    return written;
  }

 private:
  Status write_piece(const Piece& piece) {
    const particles::ParticleSet& set = piece.particles;
    if (!piece.name.empty()) {
      auto file = io::OutputFile::create_in(*folder_, piece.name);
      if (!file.ok()) return file.status();
      csv_.emplace(std::move(*file), set.dims, true, set.has_weights);
    }
    const auto view = set.view();
    Status written = csv_->append(std::span(view.position.data(), static_cast<std::size_t>(set.dims)), view.count,
                                  set.id.span(), set.weight.span());
    return written.ok() && piece.last ? csv_->commit() : written;
  }

  std::shared_ptr<const io::Roots> roots_;
  std::string directory_;
  std::optional<io::Folder> folder_;
  std::optional<io::CsvWriter> csv_;
};

// The beginning of the files' names: without a slash, and without control characters, which could drive a terminal.
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

// Each rank writes the files of its parts, piece by piece, beside the engine. The scene stays as it is meanwhile: its
// orders wait for the end of this one (net::OrderQueue). Collective.
Status write_own_parts(Context& context, const Scene& scene, const std::string& directory,
                       const std::function<std::string(int)>& name_of) {
  constexpr std::size_t kParticles = 65536;  // in a job of the thread
  constexpr std::size_t kPieces = 64;        // likewise
  const auto [begin, end] = layout::parts_of_rank(context.comm.rank(), scene.options.parts, context.comm.size());
  constexpr std::uint64_t kBytes = 1024;  // of a copied particle, as text too, and of a part
  const std::uint64_t copied_at_once = std::min<std::uint64_t>(scene.part.size(), 2 * kParticles);
  if (Status room = agree_room(
          context.comm, scene.part.size() * 8 + (copied_at_once + static_cast<std::uint64_t>(end - begin)) * kBytes,
          fmt::format("the files of {} particles", scene.part.size()));
      !room.ok())
    return room;
  const particles::ByPart by = particles::by_part(scene.part.span(), begin, end);
  FileWork work(context.files);
  const auto writer = std::make_shared<PartWriter>(context.options.roots, directory);
  work.run([writer] { return writer->open(); });
  if (Status opened = finish(context, work, [] { return false; }); !opened.ok())
    return opened;  // all ranks may, or none
  int part = begin;
  std::size_t at = 0;  // of the part's particles, those that are under way
  return finish(context, work, [&, begin = begin, end = end] {
    const auto pieces = std::make_shared<std::vector<Piece>>();
    for (std::size_t copied = 0; part < end && copied < kParticles && pieces->size() < kPieces;) {
      const auto slots = by.of(static_cast<std::size_t>(part - begin));
      const std::size_t count = std::min(kParticles - copied, slots.size() - at);
      const bool last = at + count == slots.size();
      pieces->push_back({at == 0 ? name_of(part) : "", chosen(scene, slots.subspan(at, count)), last});
      copied += count;
      at = last ? 0 : at + count;
      part += last ? 1 : 0;
    }
    if (!pieces->empty()) work.run([writer, pieces] { return writer->write(*pieces); });
    return part < end;
  });
}

Response write_parts(Context& context, Scene& scene, const wire::Json& request) {
  const auto directory = absolute_path_field(request, "directory");
  if (!directory.ok()) return failed(directory.status());
  const auto prefix = read_prefix(request);
  if (!prefix.ok()) return failed(prefix.status());

  const int parts = scene.options.parts;
  const auto name_of = [&](int part) {
    return fmt::format("{}-{:0{}}.csv", prefix.value(), part, std::to_string(parts - 1).size());
  };
  if (Status made = write_own_parts(context, scene, *directory, name_of); !made.ok()) return failed(std::move(made));
  if (!context.root()) return {};
  const auto path_of = [&](int part) { return (std::filesystem::path(*directory) / name_of(part)).string(); };
  const bool listed = static_cast<std::size_t>(parts) * path_of(0).size() <= kListedBytesMax;
  wire::Json files = listed ? wire::Json::array() : wire::Json(nullptr);
  for (int p = 0; p < parts && listed; ++p) files.push_back(path_of(p));
  return done({{"files", std::move(files)}, {"first", path_of(0)}, {"last", path_of(parts - 1)}});
}

constexpr Command kFileCommands[] = {{"load", load, Needs::scene},
                                     {"write_parts", write_parts, Needs::positions, true}};

}  // namespace

std::span<const Command> file_commands() { return kFileCommands; }

}  // namespace rcb::service
