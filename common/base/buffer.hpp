// Buffer: a growable array for trivially copyable types. It leaves new elements uninitialised (a vector would write
// them, one more pass over memory) and keeps its capacity when it shrinks.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdlib>
#include <cstring>
#include <span>
#include <type_traits>
#include <utility>

#include "common/base/check.hpp"

namespace rcb {

template <typename T>
class Buffer {
  static_assert(std::is_trivially_copyable_v<T>);
  static_assert(alignof(T) <= alignof(std::max_align_t), "realloc aligns for these alone");

 public:
  Buffer() = default;
  explicit Buffer(std::size_t size) { resize(size); }
  Buffer(const Buffer& other) { assign(other.span()); }
  Buffer(Buffer&& other) noexcept { swap(other); }
  Buffer& operator=(const Buffer& other) {
    if (this != &other) assign(other.span());
    return *this;
  }
  Buffer& operator=(Buffer&& other) noexcept {
    swap(other);
    return *this;
  }
  ~Buffer() { std::free(data_); }

  std::size_t size() const { return size_; }
  std::size_t capacity() const { return capacity_; }
  bool empty() const { return size_ == 0; }
  T* data() { return data_; }
  const T* data() const { return data_; }
  T& operator[](std::size_t i) { return data_[i]; }
  const T& operator[](std::size_t i) const { return data_[i]; }
  T* begin() { return data_; }
  T* end() { return data_ + size_; }
  const T* begin() const { return data_; }
  const T* end() const { return data_ + size_; }
  std::span<T> span() { return {data_, size_}; }
  std::span<const T> span() const { return {data_, size_}; }

  // Makes room for `capacity` elements. Returns false, and changes nothing, if the allocation fails.
  [[nodiscard]] bool try_reserve(std::size_t capacity) {
    if (capacity <= capacity_) return true;
    if (capacity > static_cast<std::size_t>(-1) / sizeof(T)) return false;
    void* grown = std::realloc(data_, capacity * sizeof(T));
    if (grown == nullptr) return false;
    data_ = static_cast<T*>(grown);
    capacity_ = capacity;
    return true;
  }
  void reserve(std::size_t capacity) { RCB_CHECK(try_reserve(capacity), "out of memory"); }
  // New elements are uninitialised.
  void resize(std::size_t size) {
    if (size > capacity_) reserve(size);
    size_ = size;
  }
  void push_back(T value) {
    if (size_ == capacity_) reserve(capacity_ == 0 ? 16 : capacity_ * 2);
    data_[size_++] = value;
  }
  void assign(std::span<const T> values) {
    resize(values.size());
    if (!values.empty()) std::memcpy(data_, values.data(), values.size_bytes());
  }
  void append(std::span<const T> values) {
    if (values.empty()) return;
    const std::size_t old = size_;
    if (old + values.size() > capacity_) reserve(std::max(old + values.size(), capacity_ * 2));
    std::memcpy(data_ + old, values.data(), values.size_bytes());
    size_ = old + values.size();
  }
  void clear() { size_ = 0; }
  // Gives the unused capacity back to the allocator.
  void shrink() {
    if (size_ == 0) return release();
    if (void* less = std::realloc(data_, size_ * sizeof(T))) {
      data_ = static_cast<T*>(less);
      capacity_ = size_;
    }
  }
  void release() {
    std::free(std::exchange(data_, nullptr));
    size_ = capacity_ = 0;
  }
  // Hands the memory over as elements of another type (bytes that don't fill a whole element are dropped); this buffer
  // is left empty.
  template <typename U>
  Buffer<U> release_as() {
    Buffer<U> other;
    other.data_ = reinterpret_cast<U*>(std::exchange(data_, nullptr));
    other.size_ = std::exchange(size_, 0) * sizeof(T) / sizeof(U);
    other.capacity_ = std::exchange(capacity_, 0) * sizeof(T) / sizeof(U);
    return other;
  }
  void swap(Buffer& other) noexcept {
    std::swap(data_, other.data_);
    std::swap(size_, other.size_);
    std::swap(capacity_, other.capacity_);
  }

 private:
  template <typename U>
  friend class Buffer;

  T* data_ = nullptr;
  std::size_t size_ = 0;
  std::size_t capacity_ = 0;
};

}  // namespace rcb
