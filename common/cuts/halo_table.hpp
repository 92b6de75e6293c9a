// HaloTable: for particles of a part that lie near its faces, which parts may need them. The faces that a particle is
// near are a number of 6 bits, and for each such number of each part there is one short list of candidates.
//
// Invariants
// 1. A particle strictly inside its part's fence is in no halo; one that is near some faces is in no halo but those of
// the
//    candidates for these faces. Both follow from the monotonicity of rounding: what is near a point is near every box
//    that holds the point.
// 2. Lists and fences are made when they are first asked for, and depend on nothing but their part.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <span>
#include <vector>

#include "common/cuts/halo.hpp"
#include "common/cuts/reach.hpp"

namespace rcb::cuts {

// An image of a particle that a part may need. Lists of them are sorted by target, then image, then part.
struct Candidate {
  std::int32_t part;
  std::int32_t target;  // the part itself, or the seat that has it
  std::int32_t image;   // index in Images
};

// The images that a halo is about, each once.
class Images {
 public:
  std::int32_t index_of(const Image& image);
  const Image& operator[](std::int32_t index) const { return all_[at(index)]; }

 private:
  std::vector<Image> all_;
  std::map<Shift, std::int32_t> index_;
};

// To whom parts belong.
struct Targets {
  int parts = 1;
  int seats = 0;  // 0: each part is a target of its own

  int count() const { return seats == 0 ? parts : seats; }
  int of(int part) const { return seats == 0 ? part : seat_of_part(part, parts, seats); }
};

struct Fence {
  geometry::Box inner;  // open; a particle in it is in no halo. Empty() where there is none
  geometry::Box outer;  // the region; closed

  // Bit 2a: near the low face of axis a; bit 2a + 1: near its high face. Along axes beyond the dimensions all is
  // infinite.
  std::uint8_t faces(const Point& x) const {
    std::uint32_t bits = 0;
    for (std::size_t a = 0; a < geometry::kDimsMax; ++a)
      bits |= static_cast<std::uint32_t>(x[a] <= inner.lo[a]) << (2 * a) |
              static_cast<std::uint32_t>(x[a] >= inner.hi[a]) << (2 * a + 1);
    return static_cast<std::uint8_t>(bits);
  }
  // False for some of the part's particles only where an axis is periodic.
  bool holds(const Point& x) const {
    bool inside = true;
    for (std::size_t a = 0; a < geometry::kDimsMax; ++a)
      inside = inside & (x[a] >= outer.lo[a]) & (x[a] <= outer.hi[a]);
    return inside;
  }
};

class HaloTable {
 public:
  // width: at least that of every particle that asks.
  HaloTable(const Reach& reach, const Targets& targets, double width, Images& images);

  // Null where the table has no room for it, or the part has too many candidates: its particles are to ask
  // reached_by().
  const Fence* fence(std::int32_t part) {
    const std::int32_t index = index_of_[at(part)];
    return index >= 0 ? &fences_[at(index)] : index == kNotMade ? make(part) : nullptr;
  }
  static constexpr std::size_t kSpare = 4;
  // Candidates for the particles of a part with a fence. Valid until the next call of fence() or candidates(). Behind
  // the last one kSpare more may be read.
  std::span<const Candidate> candidates(std::int32_t part, std::uint32_t faces) {
    const List& list = lists_of_[at(index_of_[at(part)])].near_faces[at(faces)];
    return list.begin == List::kNotMade ? make_list(part, faces) : std::span(lists_).subspan(list.begin, list.count);
  }

 private:
  static constexpr std::int32_t kNotMade = -1;
  static constexpr std::int32_t kNone = -2;
  static constexpr std::size_t kBytesMost = std::size_t{64} << 20U;

  struct List {
    static constexpr std::uint32_t kNotMade = UINT32_MAX;
    std::uint32_t begin = kNotMade;  // in lists_
    std::uint32_t count = 0;
  };
  struct Lists {
    List all;  // near the region
    std::array<List, 64> near_faces;
  };

  const Fence* make(std::int32_t part);
  List add_list(const std::vector<Candidate>& candidates);
  std::span<const Candidate> make_list(std::int32_t part, std::uint32_t faces);
  void shrink(Fence& fence, std::span<const Candidate> all) const;
  bool near(const Candidate& candidate, const geometry::Box& box) const;

  const Reach& reach_;
  Targets targets_;
  double width_;
  Within within_;
  Images& images_;
  std::vector<std::int32_t> index_of_;  // [parts], in what follows
  std::vector<Fence> fences_;
  std::vector<Lists> lists_of_;
  std::vector<Candidate> lists_;  // and kSpare that are none, at the end
};

// The candidates within the width of this box, but for those of `part` itself (or its seat) that aren't moved. For a
// point they are its halos. Errors: those of Reach::images_of(), too_large (more than `most`).
Status reached_by(const Reach& reach, const Targets& targets, const geometry::Box& box, std::int32_t part, double width,
                  Images& images, std::vector<Candidate>& found, std::size_t most = std::size_t{1} << 25U);

}  // namespace rcb::cuts
