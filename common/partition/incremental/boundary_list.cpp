#include "common/partition/incremental/boundary_list.hpp"

#include <algorithm>
#include <bit>
#include <numeric>

#include "common/base/index.hpp"

namespace rcb::partition {
namespace {

using particles::kBlock;

constexpr std::size_t kTogether = 8;  // divides kBlock
constexpr std::size_t kWaiting = 64;  // about so many particles are copied at once

}  // namespace

BoundaryList::BoundaryList(const particles::ParticleView& particles, const std::int32_t* part, std::size_t room,
                           OwnInterior& out)
    : x_(particles.all_axes()), weight_(particles.weight), part_(part), out_(out) {
  out.boundary.dims = particles.dims;
  out.boundary.has_weights = weight_ != nullptr;
  for (std::size_t a = 0; a < at(particles.dims); ++a) out.boundary.position[a].reserve(room);
  out.slot.reserve(room);
  out.part.reserve(room);
}

// Eight slots are listed per step, whether or not so many are left: how many steps it takes can be predicted, where the
// bits are can't. What is listed too many lies behind `size_` and is overwritten.
void BoundaryList::append(std::size_t slot, std::uint64_t which) {
  const std::size_t room = size_ + kBlock;
  if (room > out_.slot.size()) resize(std::max(room, 2 * out_.slot.size()));
  std::uint64_t* to = out_.slot.data() + size_;
  if (which == ~std::uint64_t{0}) {
    copy();
    std::iota(to, to + kBlock, slot);
    for (std::size_t a = 0; a < at(out_.boundary.dims); ++a)
      std::copy_n(x_[a] + slot, kBlock, out_.boundary.position[a].data() + size_);
    std::copy_n(part_ + slot, kBlock, out_.part.data() + size_);
    copied_ = size_ += kBlock;
    return;
  }
  size_ += at(std::popcount(which));
  for (; which != 0; to += kTogether)
    for (std::size_t i = 0; i < kTogether; ++i, which &= which - 1) to[i] = slot + at(std::countr_zero(which));
  if (size_ - copied_ >= kWaiting) copy();
}

void BoundaryList::copy() {
  const std::uint64_t* const slot = out_.slot.data();
  for (std::size_t a = 0; a < at(out_.boundary.dims); ++a) {
    double* const to = out_.boundary.position[a].data();
    for (std::size_t k = copied_; k < size_; ++k) to[k] = x_[a][slot[k]];
  }
  for (std::size_t k = copied_; k < size_; ++k) out_.part[k] = part_[slot[k]];
  copied_ = size_;
}

void BoundaryList::finish(std::size_t most) {
  copy();
  resize(size_);
  out_.too_many = size_ > most;
  if (out_.too_many || weight_ == nullptr) return;
  out_.boundary.weight.resize(size_);
  for (std::size_t k = 0; k < size_; ++k) out_.boundary.weight[k] = weight_[out_.slot[k]];
}

void BoundaryList::resize(std::size_t count) {
  out_.slot.resize(count);
  out_.part.resize(count);
  for (std::size_t a = 0; a < at(out_.boundary.dims); ++a) out_.boundary.position[a].resize(count);
}

}  // namespace rcb::partition
