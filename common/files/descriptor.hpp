// Descriptor: owns a file descriptor, which it closes at its end.
#pragma once

#include <utility>

#include <fcntl.h>
#include <unistd.h>

namespace rcb {

class Descriptor {
 public:
  Descriptor() = default;
  explicit Descriptor(int number) : number_(number) {}
  Descriptor(Descriptor&& other) noexcept : number_(std::exchange(other.number_, -1)) {}
  Descriptor& operator=(Descriptor&& other) noexcept {
    std::swap(number_, other.number_);
    return *this;
  }
  ~Descriptor() {
    if (number_ >= 0) ::close(number_);
  }

  int get() const { return number_; }  // -1: there is none
  bool open() const { return number_ >= 0; }
  // Gives it away: its new owner closes it.
  int release() { return std::exchange(number_, -1); }
  // Closes it before its end, for those who want to know of an error: false, with errno.
  bool close() { return ::close(std::exchange(number_, -1)) == 0; }

 private:
  int number_ = -1;
};

// Opens /dev/null for each standard stream that is closed, so that writing to it still fails. Else the next files and
// pipes would get their numbers, and be mistaken for them. To be called first thing in main().
inline void open_standard_streams() {
  for (int number = 0; number <= 2; ++number)
    if (fcntl(number, F_GETFD) < 0) (void)::open("/dev/null", O_RDONLY);  // takes the lowest free number
}

}  // namespace rcb
