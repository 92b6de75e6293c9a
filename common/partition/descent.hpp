// Descent: sends particles down a guessed tree in one branch-free pass over them. A particle comes to rest in a leaf,
// or in the bracket of the first node on its way that can't tell its side. Every resting place has a count, and the box
// of what rests there.
//
// Invariants
// 1. Places: node g as a leaf is place g, its bracket is place g + nodes. A place leads to itself, so that every
//    particle takes the same number of steps.
// 2. A tally is never less than what rests there; its box may hold particles that have gone on from a bracket, which
//    are then in the same node's subtree.
#pragma once

#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "common/base/buffer.hpp"
#include "common/partition/guess.hpp"

namespace rcb::partition {

class Descent {
 public:
  struct alignas(64) Tally {
    static constexpr double kInfinity = std::numeric_limits<double>::infinity();
    std::array<double, geometry::kDimsMax> lo{kInfinity, kInfinity, kInfinity};
    std::array<double, geometry::kDimsMax> hi{-kInfinity, -kInfinity, -kInfinity};
    std::uint64_t count = 0;
  };

  // Particles are fewer than 2^31.
  explicit Descent(const particles::ParticleView& particles) : particles_(particles) {}

  void start(const Guess& guess);
  // All particles. start[label[i]] is where particle i begins; one with a negative label, or whose start is negative,
  // has come to its part: it keeps that as its label. An empty start: all begin at node 0. The label becomes
  // the place; those in brackets are listed.
  void run(std::span<std::int32_t> label, std::span<const std::int32_t> start, Buffer<std::uint32_t>& stopped);
  // These particles go on: place[k], a node, becomes the place of particle index[k], tallied. No node's subtree is
  // deeper than `levels`. measure: boxes are wanted.
  void go_on(std::span<const std::uint32_t> index, std::span<std::int32_t> place, int levels, bool measure);
  // One particle in the bracket of a node with whole keys: where it goes (left, right), or -1 if it stays.
  std::int32_t decide(std::size_t particle, const GuessNode& node) const;
  // Takes a particle out of the count of a bracket that it leaves.
  void leave(std::int32_t place) { --tallies_[static_cast<std::size_t>(place)].count; }

  const Tally& tally(std::size_t place) const { return tallies_[place]; }
  int nodes() const { return nodes_; }

 private:
  struct Step {
    double lo;
    double hi;
    std::array<std::int32_t, 3> next;  // below the bracket, in it, above it
    std::int32_t axis;
  };

  template <int kAxes>
  void pass_first(std::span<std::int32_t> label, Buffer<std::uint32_t>& stopped);
  template <int kAxes>
  void pass_next(std::span<std::int32_t> label, std::span<const std::int32_t> start, Buffer<std::uint32_t>& stopped);
  template <typename Index>
  void descend(const Index& index, std::size_t count, std::int32_t* place, int levels) const;
  template <int kAxes, typename Index>
  void add(const Index& index, std::size_t count, const std::int32_t* place);
  template <int kAxes, bool kMeasure, typename Index>
  void add_measured(const Index& index, std::size_t count, const std::int32_t* place);
  void add_any(std::span<const std::uint32_t> index, const std::int32_t* place);
  void merge_spare();

  const particles::ParticleView& particles_;
  bool measure_ = false;
  int nodes_ = 0;
  int steps_max_ = 0;
  const Guess* guess_ = nullptr;
  std::vector<Step> steps_;
  std::vector<Tally> tallies_;
  std::vector<Tally> spare_;  // of every second particle: neighbours often share a place, and would wait for each other
};

}  // namespace rcb::partition
