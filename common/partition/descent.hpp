// Descent: sends particles down a guessed tree in one branch-free pass over them. A particle comes to rest in a leaf,
// or in the bracket of the first node on its way that can't tell its side. Every resting place has a count, and the box
// of what rests there.
//
// Invariants
// 1. Places: node g as a leaf is place g, its bracket is place g + nodes. A place leads to itself, so that every
//    particle takes the same number of steps.
// 2. A tally's box may hold particles that have gone on from a bracket: they are in the same node's subtree. Its count
//    is what came to rest there, those included whom a search among the waiting sends on.
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

  // A particle on its way, with its coordinates: what is near in a list need not be near in the set.
  struct Mover {
    Point at;
    std::uint32_t index;
    std::int32_t place;
  };

  // Particles are fewer than 2^31.
  explicit Descent(const particles::ParticleView& particles) : particles_(particles) {}

  void start(const Guess& guess);
  // All particles. start[label[i]] is where particle i begins; one with a negative label, or whose start is negative,
  // has come to its part: it keeps that as its label. An empty start: all begin at node 0. The label becomes the
  // place; those in brackets also wait, in the list of their node's depth.
  void run(std::span<std::int32_t> label, std::span<const std::int32_t> start, std::vector<Buffer<Mover>>& waiting);
  // These go on from the nodes that are their places, all of one depth; otherwise as above.
  void go_on(std::span<Mover> movers, int depth, std::span<std::int32_t> label, std::vector<Buffer<Mover>>& waiting);

  const Tally& tally(std::size_t place) const { return tallies_[place]; }
  int nodes() const { return nodes_; }

 private:
  // What is read of a node for each particle in its bracket.
  struct Stop {
    std::int32_t depth;
    bool whole;
  };
  // A bracket of whole keys.
  struct WholeStep {
    Key lo;
    Key hi;
    std::array<std::size_t, geometry::kDimsMax> axes;
    std::array<std::int32_t, 3> next;  // below the bracket, in it, above it
  };
  struct Step {
    double lo;
    double hi;
    std::array<std::int32_t, 3> next;  // below the bracket, in it, above it
    std::int32_t axis;
  };

  template <int kAxes>
  void pass(std::span<std::int32_t> label, std::span<const std::int32_t> start, std::vector<Buffer<Mover>>& waiting);
  template <typename Point>
  void descend(const Point& point, std::size_t count, std::int32_t* place, int levels) const;
  void first_step(std::size_t first, std::size_t count, std::int32_t* place) const;
  template <int kAxes, bool kMeasure, typename Point>
  void add(const Point& point, std::size_t count, const std::int32_t* place);
  // Of a block of movers those in brackets of whole keys go on, as far as their keys are outside of brackets.
  void settle(std::span<Mover> movers);
  void rest(Mover& mover, std::span<std::int32_t> label, std::vector<Buffer<Mover>>& waiting) const;
  void merge_spare();

  const particles::ParticleView& particles_;
  int nodes_ = 0;
  int steps_max_ = 0;
  const Guess* guess_ = nullptr;
  std::vector<Step> steps_;
  std::vector<Stop> stops_;        // by node
  std::vector<WholeStep> wholes_;  // likewise; empty if no bracket is of whole keys
  std::vector<Tally> tallies_;
  std::vector<Tally> spare_;  // of every second particle: neighbours often share a place, and would wait for each other
};

}  // namespace rcb::partition
