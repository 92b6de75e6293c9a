// The text dumps of LAMMPS and LIGGGHTS. A frame is a series of items, each a line "ITEM: NAME ..." and what belongs to
// it; the last one, ATOMS, names the columns of its rows. See https://docs.lammps.org/dump.html.
#include <array>
#include <charconv>
#include <cmath>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "common/io/formats/fields.hpp"
#include "common/io/formats/frame_text.hpp"

namespace rcb::io {
namespace {

constexpr std::string_view kItem = "ITEM:";
constexpr std::string_view kAxes = "xyz";

// Of several columns for one axis the first of these is taken: wrapped into the box before unwrapped, since the service
// knows no periodic images, and as they are before scaled.
constexpr std::array<std::string_view, 4> kEndings{"", "s", "u", "su"};

struct Side {
  double lo = 0;
  double hi = 0;
};

struct Box {
  bool known = false;
  bool skewed = false;  // triclinic: coordinates are scaled along edges that aren't axes
  std::array<Side, 3> sides{};
};

// The axis of a scaled coordinate such as xs or ysu.
std::optional<std::size_t> scaled_axis(std::string_view name) {
  if (name.empty()) return std::nullopt;
  const std::size_t axis = kAxes.find(name[0]);
  if (axis == std::string_view::npos || (name.substr(1) != "s" && name.substr(1) != "su")) return std::nullopt;
  return axis;
}

// The columns' names, the best column of each axis being called x, y or z.
std::vector<std::string> with_axes_named(std::span<const std::string> names) {
  std::vector<std::string> named(names.begin(), names.end());
  for (const char axis : kAxes)
    for (const std::string_view ending : kEndings) {
      const auto found = std::find(names.begin(), names.end(), axis + std::string(ending));
      if (found == names.end()) continue;
      named[static_cast<std::size_t>(found - names.begin())] = std::string(1, axis);
      break;
    }
  return named;
}

class LammpsFrames final : public FrameText {
 public:
  using FrameText::FrameText;

 private:
  using Read = Result<bool>;  // false: the text ends

  const char* columns_from() const override { return "ITEM: ATOMS names"; }

  Result<std::optional<Points>> read_frame() override {
    timestep_.reset();
    box_ = {};
    begun_.count.reset();
    for (;;) {
      const std::uint64_t at = lines_.line();
      const auto line = next_line();
      if (!line) return line.status();
      if (!*line) return std::optional<Points>();
      const std::string_view text = **line;
      if (!text.starts_with(kItem))
        return fault(at, fmt::format("'{}' where a line \"ITEM: ...\" should begin", shown(text)),
                     "was it written by a dump of the style atom or custom?");
      const std::string_view item = trimmed(text.substr(kItem.size()));
      if (item == "ATOMS" || item.starts_with("ATOMS ")) return read_atoms(at, item.substr(5));
      const auto read = read_item(at, item);
      if (!read) return read.status();
      if (!*read) return std::optional<Points>();
    }
  }

  Read read_item(std::uint64_t at, std::string_view item) {
    if (item == "TIMESTEP") return read_timestep();
    if (item == "NUMBER OF ATOMS") return read_count();
    if (item.starts_with("BOX BOUNDS")) return read_box(item.substr(10));
    if (item.starts_with("ENTRIES") || item.starts_with("NUMBER OF ENTRIES") || item.starts_with("NUMBER OF GRID"))
      return fault(at, fmt::format("'ITEM: {}' belongs to a dump without atoms", shown(item)),
                   "take a dump of the style atom or custom");
    return skip_item();
  }

  // Others, such as UNITS and TIME, end where the next begins.
  Read skip_item() {
    for (;;) {
      const auto line = lines_.peek(1);
      if (!line) return line.status();
      if (line->starts_with(kItem)) return true;
      const auto skipped = next_line();
      if (!skipped) return skipped.status();
      if (!*skipped) return false;
    }
  }

  template <typename Integer>
  Read read_integer(const char* item, Integer& value) {
    const std::uint64_t at = lines_.line();
    const auto line = next_line();
    if (!line) return line.status();
    if (!*line) return false;
    const std::string& text = **line;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (error == std::errc{} && end == text.data() + text.size()) return true;
    return fault(at, fmt::format("'{}' is no {}", shown(text), item), "a whole number stands there");
  }

  Read read_timestep() {
    std::int64_t timestep = 0;
    auto read = read_integer("timestep", timestep);
    if (!read || !*read) return read;
    timestep_ = timestep;
    begun_.which = fmt::format("frame {} (timestep {})", number_, timestep);
    return read;
  }

  Read read_count() {
    std::uint64_t count = 0;
    auto read = read_integer("number of atoms", count);
    if (read && *read) begun_.count = count;
    return read;
  }

  // kinds: of the boundaries, such as "pp pp ff", behind "xy xz yz" or "abc origin" where the box is skewed.
  Read read_box(std::string_view kinds) {
    box_.skewed = kinds.find("xy xz yz") != std::string_view::npos || kinds.find("abc") != std::string_view::npos;
    for (Side& side : box_.sides) {
      const std::uint64_t at = lines_.line();
      const auto line = next_line();
      if (!line) return line.status();
      if (!*line) return false;
      const auto fields = split_fields(**line, kBlankSeparator);
      const auto lo = fields.size() < 2 ? std::nullopt : number_in(fields[0]);
      const auto hi = fields.size() < 2 ? std::nullopt : number_in(fields[1]);
      if (!lo || !hi || !std::isfinite(*lo) || !std::isfinite(*hi))
        return fault(at, fmt::format("'{}' are no bounds of the box", shown(**line)), "two finite numbers stand there");
      side = {*lo, *hi};
    }
    box_.known = true;
    return true;
  }

  Result<std::optional<Points>> read_atoms(std::uint64_t at, std::string_view columns) {
    if (!begun_.count) return fault(at, "ITEM: ATOMS without ITEM: NUMBER OF ATOMS before it", "write the dump again");
    TextLayout layout;
    for (const std::string_view name : split_fields(columns, kBlankSeparator)) layout.names.emplace_back(name);
    layout.column_count = layout.names.size();
    const bool asked = !options_.columns.empty();
    const std::vector<std::string> named = asked ? layout.names : with_axes_named(layout.names);
    if (!asked && std::none_of(kAxes.begin(), kAxes.end(), [&](char axis) {
          return std::find(named.begin(), named.end(), std::string(1, axis)) != named.end();
        }))
      return fault(at,
                   fmt::format("no positions among the columns {}", shown(fmt::format("{}", fmt::join(named, " ")))),
                   "dump them: dump 1 all custom 100 run.lammpstrj id x y z");
    auto chosen = choose_columns(lines_.name(), options_, named, named.size());
    if (!chosen) return chosen.status();
    layout.columns = *chosen;
    if (Status fits = check_scaled(at, layout); !fits) return fits;
    auto points = read_rows(layout, *begun_.count, LastLine::must_end);
    if (!points || !*points) return points;
    if (Status status = unscale(layout, **points); !status) return status;
    (*points)->timestep = timestep_;
    return points;
  }

  Status check_scaled(std::uint64_t at, const TextLayout& layout) const {
    for (std::size_t a = 0; a < static_cast<std::size_t>(layout.columns.dims); ++a) {
      const std::string& name = layout.names[layout.columns.axis[a]];
      if (!scaled_axis(name)) continue;
      if (box_.skewed)
        return fault(at, fmt::format("'{}' is scaled by a triclinic box, which isn't undone", name),
                     "dump positions as they are: id x y z, or dump_modify 1 scale no for a dump of the style atom");
      if (!box_.known)
        return fault(at, fmt::format("'{}' is scaled by a box whose bounds aren't there", name),
                     "keep ITEM: BOX BOUNDS in each frame, or dump x y z");
    }
    return {};
  }

  Status unscale(const TextLayout& layout, Points& points) const {
    for (std::size_t a = 0; a < static_cast<std::size_t>(layout.columns.dims); ++a) {
      const std::string& name = layout.names[layout.columns.axis[a]];
      const auto axis = scaled_axis(name);
      if (!axis) continue;
      const auto [lo, hi] = box_.sides[*axis];
      for (std::size_t row = 0; row < points.count; ++row) {
        double& value = points.position[a][row];
        value = lo + value * (hi - lo);
        if (!std::isfinite(value))
          return {Code::not_finite,
                  fmt::format("{}:{}: {}: '{}' of row {} is beyond all numbers in its box", lines_.name(), begun_.line,
                              begun_.which, name, row + 1),
                  "look at the box's bounds"};
      }
    }
    return {};
  }

  std::optional<std::int64_t> timestep_;
  Box box_;
};

}  // namespace

std::unique_ptr<TrajectoryReader> read_lammps(LineReader lines, const ReadOptions& options) {
  return std::make_unique<LammpsFrames>(std::move(lines), options);
}

}  // namespace rcb::io
