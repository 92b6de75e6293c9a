// rcbd/positions.hpp, a part of rcbd/rcbd.hpp: errors, and the solver's arrays as rcbd sees them.
#ifndef RCBD_POSITIONS_HPP
#define RCBD_POSITIONS_HPP

#if !defined(__cpp_exceptions) && !defined(__EXCEPTIONS)
#error "rcbd/rcbd.hpp reports failures by exceptions; without them call the functions of rcbd/rcbd.h"
#endif

#include <array>
#include <cstddef>
#include <cstdint>
#include <initializer_list>
#include <limits>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <vector>

#include <rcbd/rcbd.h>

namespace rcbd {

namespace detail {

template <typename T>
struct IsArray : std::false_type {};
template <typename T, std::size_t N>
struct IsArray<std::array<T, N>> : std::true_type {};

// A temporary that takes its values along when it goes: a vector or an Array, but not a span.
template <typename Range, typename = decltype(std::declval<Range&>().data())>
using Owner =
    std::enable_if_t<!std::is_lvalue_reference<Range>::value &&
                     (!std::is_trivially_destructible<Range>::value || IsArray<std::remove_cv_t<Range>>::value)>;

}  // namespace detail

// what() is the message. The code is an rcbd_code, or one of a later version.
class Error : public std::runtime_error {
 public:
  Error(int code, const std::string& message, const std::string& hint = "")
      : std::runtime_error(message), code_(code), hint_(hint) {}
  int code() const noexcept { return code_; }
  const char* code_name() const noexcept { return rcbd_code_name(code_); }
  std::string message() const { return what(); }
  const std::string& hint() const noexcept { return hint_; }

 private:
  int code_;
  std::string hint_;
};

// Throws what a function of rcbd.h has told.
inline void check(int code) {
  if (code != RCBD_OK) throw Error(code, rcbd_message(), rcbd_hint());
}

// Values of the solver: of a vector, a std::array, a std::span, whatever has data() and size(), or a pointer and a
// number.
template <typename T>
class View {
 public:
  View() = default;
  View(const T* data, std::size_t size) : data_(data), size_(size), given_(true) {}
  template <typename Range, typename = std::enable_if_t<
                                std::is_convertible<decltype(std::declval<const Range&>().data()), const T*>::value>>
  View(const Range& values) : View(values.data(), values.size()) {}
  template <typename Range, typename = detail::Owner<Range>, typename = void>
  View(Range&&) = delete;

  const T* data() const { return data_; }
  std::size_t size() const { return size_; }
  // Whether there are any, or a solver that has no particles gave its empty array.
  bool given() const { return given_; }

 private:
  const T* data_ = nullptr;
  std::size_t size_ = 0;
  bool given_ = false;
};

namespace detail {

// What a row of positions may be: a number, or an array of one to three.
template <typename T>
struct Row {};
template <>
struct Row<double> {
  using Number = double;
};
template <>
struct Row<float> {
  using Number = float;
};
template <typename T, std::size_t D>
struct Row<std::array<T, D>> : Row<T> {};
template <typename T, std::size_t D>
struct Row<T[D]> : Row<T> {};

template <typename T>
using NumberOf = typename Row<std::remove_cv_t<T>>::Number;
template <typename Range>
using ElementOf = std::remove_pointer_t<decltype(std::declval<Range&>().data())>;
template <typename T>
using Writable = std::enable_if_t<!std::is_const<std::remove_all_extents_t<T>>::value>;

// How many numbers a row has.
template <typename T>
int dims_of(int given) {
  return std::is_arithmetic<T>::value ? given : static_cast<int>(sizeof(T) / sizeof(NumberOf<T>));
}

template <typename T>
std::size_t rows_of(std::size_t size, int dims) {
  return std::is_arithmetic<T>::value ? size / static_cast<std::size_t>(dims < 1 ? 1 : dims) : size;
}

// An array with a value for each row, or null.
template <typename T>
const T* column(const View<T>& values, std::int64_t count, const char* what) {
  if (values.given() && values.size() != static_cast<std::size_t>(count))
    throw Error(RCBD_INVALID_ARGUMENT,
                std::to_string(values.size()) + " " + what + " for " + std::to_string(count) + " positions",
                "give one for each position, or none");
  return values.data();
}

}  // namespace detail

// Positions in arrays of the solver, of double or float: rcbd_positions. Those of wrong lengths are refused where they
// are used, so that a call of all processes fails for all of them.
class Positions {
 public:
  Positions() = default;
  // [count][dims]: a vector of numbers, or of std::array<double, 3>, whose dims it takes.
  template <typename Range, typename T = detail::ElementOf<const Range>, typename = detail::NumberOf<T>>
  Positions(const Range& xyz, int dims = 3) : Positions(xyz.data(), detail::rows_of<T>(xyz.size(), dims), dims) {
    if (std::is_arithmetic<T>::value && (dims < 1 || xyz.size() % static_cast<std::size_t>(dims) != 0))
      wrong_ =
          Error(RCBD_INVALID_ARGUMENT,
                std::to_string(xyz.size()) + " numbers are no positions in " + std::to_string(dims) + " dimensions",
                "give the number of dimensions after the array, if it is not 3");
  }
  template <typename Range, typename = detail::Owner<Range>>
  Positions(Range&&, int dims = 3) = delete;
  // Pointer and number of rows: also of double xyz[count][3].
  template <typename T, typename Number = detail::NumberOf<T>>
  Positions(const T* xyz, std::size_t count, int dims = 3) {
    const auto* const first = reinterpret_cast<const Number*>(xyz);
    dims = detail::dims_of<T>(dims);
    for (int a = 0; a < 3 && a < dims; ++a) set_axis(a, first == nullptr ? nullptr : first + a);
    set_shape<Number>(count, static_cast<std::size_t>(dims > 0 ? dims : 1), dims);
  }
  // An array for each axis: axes(x, y, z).
  template <typename First, typename... More, typename T = detail::ElementOf<const First>>
  static Positions axes(const First& x, const More&... more) {
    Positions positions = axes<std::remove_cv_t<T>>({x.data(), more.data()...}, x.size());
    for (const std::size_t size : {x.size(), more.size()...})
      if (size != x.size())
        positions.wrong_ = Error(RCBD_INVALID_ARGUMENT, std::to_string(x.size()) + " values on one axis, " +
                                                            std::to_string(size) + " on another");
    return positions;
  }
  // The same of pointers, with `stride` elements from one row to the next: axes({&p[0].x, &p[0].y}, n, sizeof p[0] /
  // 8).
  template <typename T, typename = detail::NumberOf<T>>
  static Positions axes(std::initializer_list<const T*> first, std::size_t count, std::size_t stride = 1) {
    Positions positions;
    int a = 0;
    for (const T* axis : first) positions.set_axis(a++, axis);
    positions.set_shape<T>(count, stride, a);
    return positions;
  }

  std::size_t count() const { return static_cast<std::size_t>(raw_.count); }
  int dims() const { return raw_.dims; }
  const rcbd_positions* get() const {
    if (wrong_.code() != RCBD_OK) throw wrong_;
    return &raw_;
  }

 protected:
  explicit Positions(const rcbd_positions& raw) : raw_(raw) {}

 private:
  void set_axis(int a, const void* first) {
    if (a < 3) raw_.axis[a] = const_cast<void*>(first);
  }
  template <typename Number>
  void set_shape(std::size_t count, std::size_t stride, int dims) {
    raw_.count = static_cast<std::int64_t>(count);
    raw_.stride = static_cast<std::int64_t>(stride);
    raw_.dims = dims;
    raw_.single = std::is_same<Number, float>::value;
  }

  rcbd_positions raw_ = RCBD_POSITIONS;
  Error wrong_{RCBD_OK, ""};
};

// Those that wrap() may move.
class WritablePositions : public Positions {
 public:
  explicit WritablePositions(const rcbd_positions& raw) : Positions(raw) {}
  template <typename Range, typename T = detail::ElementOf<Range>, typename = detail::NumberOf<T>,
            typename = detail::Writable<T>>
  WritablePositions(Range& xyz, int dims = 3) : Positions(xyz, dims) {}
  template <typename T, typename = detail::NumberOf<T>, typename = detail::Writable<T>>
  WritablePositions(T* xyz, std::size_t count, int dims = 3) : Positions(xyz, count, dims) {}
  template <typename First, typename... More, typename T = detail::ElementOf<First>>
  static WritablePositions axes(First& x, More&... more) {
    return WritablePositions(Positions::axes(x, more...));
  }
  template <typename T, typename = detail::NumberOf<T>, typename = detail::Writable<T>>
  static WritablePositions axes(std::initializer_list<T*> first, std::size_t count, std::size_t stride = 1) {
    const T* axis[3] = {};
    int dims = 0;
    for (T* one : first) {
      if (dims < 3) axis[dims] = one;
      ++dims;
    }
    rcbd_positions raw = *Positions::axes({axis[0], axis[1], axis[2]}, count, stride).get();
    raw.dims = dims;
    return WritablePositions(raw);
  }

 private:
  explicit WritablePositions(const Positions& positions) : Positions(positions) {}
};

// A place, or a length an axis; those of unused axes are not read.
using Point = std::array<double, 3>;

// As long as it is infinite along an axis, nothing is periodic there.
struct Box {
  Point lo{{-std::numeric_limits<double>::infinity(), -std::numeric_limits<double>::infinity(),
            -std::numeric_limits<double>::infinity()}};
  Point hi{{std::numeric_limits<double>::infinity(), std::numeric_limits<double>::infinity(),
            std::numeric_limits<double>::infinity()}};
};

// Moves positions outside of [lo, hi) into it, by whole periods: rcbd_wrap().
inline void wrap(const WritablePositions& positions, const Point& lo, const Point& hi) {
  check(rcbd_wrap(positions.get(), lo.data(), hi.data()));
}

}  // namespace rcbd

#endif
