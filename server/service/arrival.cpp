#include "server/service/arrival.hpp"

#include <algorithm>
#include <utility>

namespace rcb::service {

using particles::kBlock;
using particles::Range;

Arrival::Arrival(std::shared_ptr<Loan> loan) : loan_(std::move(loan)), count_(loan_->part.size()) {
  marks_.assign(particles::blocks_of(count_), 0);
  block_part_.assign(marks_.size(), kUnknown);
  ranges_.reset(loan_->dims, count_);
}

std::int32_t Arrival::part_of_block(std::size_t block) {
  std::int32_t& known = block_part_[block];
  if (known != kUnknown) return known;
  const std::size_t begin = block * kBlock;
  const auto parts = loan_->part.subspan(begin, std::min(kBlock, count_ - begin));
  std::int32_t other = 0;
  for (const std::int32_t part : parts) other |= part ^ parts[0];
  return known = other == 0 ? parts[0] : kMixed;
}

bool Arrival::any_outside(std::size_t axis, std::size_t block, std::uint64_t first, std::span<const double> values) {
  const std::uint64_t begin = std::max<std::uint64_t>(first, block * kBlock);
  const std::uint64_t end = std::min<std::uint64_t>(first + values.size(), (block + 1) * kBlock);
  const auto x = values.subspan(begin - first, end - begin);
  const std::int32_t part = part_of_block(block);
  Range& range = ranges_.of[axis][block];
  if (part != kMixed) {
    range.extend(particles::range_of(x));
    return !loan_->regions->hold(axis, part, range);
  }
  range = Range::everything();
  return loan_->regions->outside(axis, x, loan_->part.data() + begin) != 0;
}

void Arrival::add(std::size_t axis, std::uint64_t first, std::span<const double> values) {
  if (!whole_ || values.empty()) return;
  const std::lock_guard lock(loan_->mutex);
  whole_ = loan_->lent && axis < static_cast<std::size_t>(loan_->dims) && first == seen_[axis] &&
           values.size() <= count_ - first;
  if (!whole_) return;
  seen_[axis] += values.size();
  for (std::size_t block = first / kBlock; block * kBlock < seen_[axis]; ++block)
    marks_[block] |= static_cast<std::uint8_t>(any_outside(axis, block, first, values));
}

bool Arrival::holds(const Loan* loan) const {
  if (!whole_ || loan != loan_.get()) return false;
  for (std::size_t axis = 0; axis < static_cast<std::size_t>(loan->dims); ++axis)
    if (seen_[axis] != count_) return false;
  return true;
}

void Loans::lend(const Scene& scene) {
  take_back(scene.name);
  auto loan = std::make_shared<Loan>();
  loan->part = scene.part.span();
  loan->regions = &scene.regions;
  loan->dims = scene.options.dims;
  const std::lock_guard lock(mutex_);
  loans_[scene.name] = std::move(loan);
}

std::shared_ptr<const Loan> Loans::take_back(const std::string& scene) {
  std::shared_ptr<Loan> loan;
  {
    const std::lock_guard lock(mutex_);
    if (auto found = loans_.extract(scene)) loan = std::move(found.mapped());
  }
  if (!loan) return nullptr;
  const std::lock_guard lock(loan->mutex);
  loan->lent = false;
  return loan;
}

void Loans::take_back_all() {
  std::map<std::string, std::shared_ptr<Loan>> all;
  {
    const std::lock_guard lock(mutex_);
    all.swap(loans_);
  }
  for (const auto& [name, loan] : all) {
    const std::lock_guard lock(loan->mutex);
    loan->lent = false;
  }
}

std::shared_ptr<Arrival> Loans::begin(const std::string& scene, int dims, std::uint64_t count) {
  const std::lock_guard lock(mutex_);
  const auto found = loans_.find(scene);
  if (found == loans_.end() || count == 0) return nullptr;
  // These don't change while the loan lasts, and it lasts as long as it is found here.
  if (found->second->dims != dims || found->second->part.size() != count) return nullptr;
  return std::make_shared<Arrival>(found->second);
}

}  // namespace rcb::service
