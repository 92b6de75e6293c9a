#include "common/partition/incremental/boundary_list.hpp"

#include <bit>
#if defined(__x86_64__)
#include <immintrin.h>
#endif

#include "common/base/cpu.hpp"
#include "common/base/index.hpp"

namespace rcb::partition {
namespace {

using particles::kBlock;

// Where the next boundary particle goes.
struct Place {
  std::array<double*, geometry::kDimsMax> position;
  std::uint64_t* slot;
  std::int32_t* part;
};

std::size_t list_one_by_one(const Axes& x, std::size_t axes, std::size_t slot, const std::int32_t* part,
                            std::uint64_t which, const Place& to) {
  std::size_t listed = 0;
  for (; which != 0; which &= which - 1, ++listed) {
    const auto k = at(std::countr_zero(which));
    to.slot[listed] = slot + k;
    to.part[listed] = part[k];
    for (std::size_t a = 0; a < axes; ++a) to.position[a][listed] = x[a][k];
  }
  return listed;
}

#if defined(__x86_64__)
// Of a full block.
[[gnu::target("avx512f,avx512dq,avx512bw,avx512vl,avx2,popcnt,bmi")]] std::size_t list_in_avx512(
    const Axes& x, std::size_t axes, std::size_t slot, const std::int32_t* part, std::uint64_t which, const Place& to) {
  std::size_t listed = 0;
  __m512i slots =
      _mm512_add_epi64(_mm512_set1_epi64(static_cast<std::int64_t>(slot)), _mm512_set_epi64(7, 6, 5, 4, 3, 2, 1, 0));
  for (std::size_t i = 0; i < kBlock && which >> i != 0; i += 8) {
    const auto eight = static_cast<__mmask8>(which >> i);
    for (std::size_t a = 0; a < axes; ++a)
      _mm512_storeu_pd(to.position[a] + listed, _mm512_maskz_compress_pd(eight, _mm512_loadu_pd(x[a] + i)));
    _mm512_storeu_si512(to.slot + listed, _mm512_maskz_compress_epi64(eight, slots));
    const __m256i parts = _mm256_loadu_si256(reinterpret_cast<const __m256i*>(part + i));
    _mm256_storeu_si256(reinterpret_cast<__m256i*>(to.part + listed), _mm256_maskz_compress_epi32(eight, parts));
    listed += at(std::popcount(unsigned{eight}));
    slots = _mm512_add_epi64(slots, _mm512_set1_epi64(8));
  }
  return listed;
}
#endif

}  // namespace

Axes axes_of(const particles::ParticleView& particles) {
  Axes x = particles.position;
  for (std::size_t a = at(particles.dims); a < x.size(); ++a) x[a] = x[0];
  return x;
}

void BoundaryList::append(const Axes& x, std::size_t slot, const std::int32_t* part, std::size_t count,
                          std::uint64_t which) {
  if (size_ + kBlock > out_.slot.size()) resize(std::max(size_ + kBlock, 2 * out_.slot.size()));
  const std::size_t axes = at(out_.boundary.dims);
  Place to{{}, out_.slot.data() + size_, out_.part.data() + size_};
  for (std::size_t a = 0; a < axes; ++a) to.position[a] = out_.boundary.position[a].data() + size_;
#if defined(__x86_64__)
  if (has_avx512() && count == kBlock) {
    size_ += list_in_avx512(x, axes, slot, part, which, to);
    return;
  }
#endif
  size_ += list_one_by_one(x, axes, slot, part, which, to);
}

void BoundaryList::resize(std::size_t count) {
  out_.slot.resize(count);
  out_.part.resize(count);
  for (std::size_t a = 0; a < at(out_.boundary.dims); ++a) out_.boundary.position[a].resize(count);
}

}  // namespace rcb::partition
