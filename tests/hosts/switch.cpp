// rcb_switch PORT ...: a switch between the network interfaces named, whose links have a delay, a loss and a bandwidth.
// The kernel's own means for that (netem) is not in every kernel.
//
// A link is a port's cable. Each of its two directions sends one frame after another at the link's bandwidth; a frame
// is then `delay` on its way, or lost. So a frame from one host to another passes two links. Queues are as long as the
// senders' windows. The kernel hands over what TCP sends in frames of up to 64 KiB, which its network card would
// divide: the time of such a frame is that of its packets, but it is lost as a whole.
//
// Standard input has the commands, standard output an answer to each; the program ends with its input.
//   set PORT DELAY LOSS RATE    seconds, share of the frames, bits/s (0: without limit); answer: ok
//   count                       answer: the chain, and for each port in order: frames and bytes that came, that were
//                               sent, and frames lost. Since the start.
// The chain is the largest number of messages (frames with TCP data) of which each was sent by a host after the one
// before it had arrived there. Where the delay is long beside all else, messages that don't wait for each other are on
// their way together, and the chain is the number that do.
#include <algorithm>
#include <array>
#include <cerrno>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <iostream>
#include <map>
#include <queue>
#include <sstream>
#include <string>
#include <vector>

#include <arpa/inet.h>
#include <linux/if_packet.h>
#include <net/ethernet.h>
#include <net/if.h>
#include <poll.h>
#include <sched.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include "common/base/random.hpp"

namespace {

// virtio_net_hdr of <linux/virtio_net.h>, which is no C++. The kernel says in it what it has left for a network card.
struct Head {
  std::uint8_t flags;
  std::uint8_t gso_type;  // 0: one packet
  std::uint16_t hdr_len;
  std::uint16_t gso_size;  // data of each packet
  std::uint16_t csum_start;
  std::uint16_t csum_offset;
};

using Frame = std::vector<unsigned char>;  // a Head, then the Ethernet frame
using Address = std::array<unsigned char, ETH_ALEN>;

constexpr std::size_t kHead = sizeof(Head);
constexpr std::size_t kFrameBytesMax = kHead + ETH_HLEN + 65'536;
constexpr std::size_t kBetweenPackets = 24;  // bytes' time that Ethernet needs for each: preamble, checksum, gap
constexpr int kSocketBytes = 256 << 20;
constexpr int kFramesAtOnce = 64;  // of a port, before the others' turn

double now() {
  timespec time{};
  clock_gettime(CLOCK_MONOTONIC, &time);
  return static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec);
}

[[noreturn]] void fail(const std::string& what) {
  std::perror(("rcb_switch: " + what).c_str());
  std::exit(1);
}

std::size_t header_bytes(const Frame& frame) {
  if (frame.size() < kHead + ETH_HLEN + 40 || frame[kHead + 12] != 8 || frame[kHead + 13] != 0 ||
      frame[kHead + ETH_HLEN + 9] != IPPROTO_TCP)
    return 0;
  const std::size_t ip = std::size_t{4} * (frame[kHead + ETH_HLEN] & 15U);
  if (frame.size() < kHead + ETH_HLEN + ip + 20) return 0;
  return ETH_HLEN + ip + std::size_t{4} * (frame[kHead + ETH_HLEN + ip + 12] >> 4U);
}

// Bytes after the header of a frame of TCP over IPv4; 0 of others. Short frames may be padded, so the packet's own
// length tells.
std::size_t data_bytes(const Frame& frame) {
  const std::size_t header = header_bytes(frame);
  if (header == 0) return 0;
  const std::size_t length = ETH_HLEN + std::size_t{256} * frame[kHead + ETH_HLEN + 2] + frame[kHead + ETH_HLEN + 3];
  return length > header ? length - header : 0;
}

// What a link carries for this frame, in bytes.
std::size_t wire_bytes(const Frame& frame) {
  Head head{};
  std::memcpy(&head, frame.data(), sizeof head);
  const std::size_t bytes = frame.size() - kHead;
  if (head.gso_type == 0 || head.gso_size == 0) return bytes + kBetweenPackets;
  const std::size_t header = header_bytes(frame);
  const std::size_t packets = (bytes - header + head.gso_size - 1) / head.gso_size;
  return bytes + (packets - 1) * header + packets * kBetweenPackets;
}

struct Counts {
  std::uint64_t frames = 0;
  std::uint64_t bytes = 0;
};

struct Direction {
  double free = 0;  // when its last frame is out
  rcb::Random random;
  Counts counts = {};
};

struct Port {
  std::string name;
  int socket = -1;
  double delay = 0;
  double loss = 0;
  double rate = 0;
  Direction in;
  Direction out;
  std::uint64_t lost = 0;
  std::uint64_t chain = 0;  // of the messages that have arrived at its host

  double seconds(std::size_t bytes) const { return rate > 0 ? 8.0 * static_cast<double>(bytes) / rate : 0; }
  bool loses(Direction& direction) {
    const bool lost_now = loss > 0 && direction.random.uniform() < loss;
    lost += lost_now ? 1 : 0;
    return lost_now;
  }
};

struct Flight {
  double due = 0;
  std::uint64_t number = 0;  // frames of one time keep their order
  double entered = 0;        // the switch, with its first byte; negative: it is on its way out already
  std::size_t to = 0;
  std::uint64_t chain = 0;
  Frame frame;

  bool operator<(const Flight& other) const { return due != other.due ? due > other.due : number > other.number; }
};

int open_port(const std::string& name) {
  const int index = static_cast<int>(if_nametoindex(name.c_str()));
  if (index == 0) fail(name);
  const int made = socket(AF_PACKET, SOCK_RAW | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
  if (made < 0) fail("socket");
  const int on = 1;
  const auto set = [&](int level, int option, int value) {
    if (setsockopt(made, level, option, &value, sizeof value) != 0) fail("setsockopt");
  };
  set(SOL_PACKET, PACKET_VNET_HDR, on);
  set(SOL_PACKET, PACKET_IGNORE_OUTGOING, on);
  set(SOL_SOCKET, SO_RCVBUFFORCE, kSocketBytes);
  set(SOL_SOCKET, SO_SNDBUFFORCE, kSocketBytes);
  sockaddr_ll place{};
  place.sll_family = AF_PACKET;
  place.sll_protocol = htons(ETH_P_ALL);
  place.sll_ifindex = index;
  if (bind(made, reinterpret_cast<const sockaddr*>(&place), sizeof place) != 0) fail("bind");
  return made;
}

class Switch {
 public:
  explicit Switch(const std::vector<std::string>& names) {
    for (const std::string& name : names) {
      const std::uint64_t seed = 2 * ports_.size();
      ports_.push_back({.name = name,
                        .socket = open_port(name),
                        .in = {.random = rcb::Random(seed)},
                        .out = {.random = rcb::Random(seed + 1)}});
    }
  }

  void run() {
    std::vector<pollfd> waiting{{STDIN_FILENO, POLLIN, 0}};
    for (const Port& port : ports_) waiting.push_back({port.socket, POLLIN, 0});
    while (true) {
      move_on();
      timespec left{};
      if (!flights_.empty()) {
        const double seconds = std::max(0.0, flights_.top().due - now());
        left.tv_sec = static_cast<time_t>(seconds);
        left.tv_nsec = static_cast<long>(1e9 * (seconds - std::floor(seconds)));
      }
      if (ppoll(waiting.data(), waiting.size(), flights_.empty() ? nullptr : &left, nullptr) < 0 && errno != EINTR)
        fail("ppoll");
      if (waiting[0].revents != 0 && !obey()) return;
      for (std::size_t k = 0; k < ports_.size(); ++k)
        if (waiting[k + 1].revents != 0) take(k);
    }
  }

 private:
  // Frames that a host has sent.
  void take(std::size_t from) {
    Port& port = ports_[from];
    for (int k = 0; k < kFramesAtOnce; ++k) {
      const ssize_t bytes = recv(port.socket, room_.data(), room_.size(), 0);
      if (bytes < static_cast<ssize_t>(kHead + ETH_HLEN)) return;  // none, or the link was pulled
      const Frame frame(room_.begin(), room_.begin() + bytes);
      const std::size_t wire = wire_bytes(frame);
      ++port.in.counts.frames;
      port.in.counts.bytes += wire;
      const double seconds = port.seconds(wire);
      port.in.free = std::max(now(), port.in.free) + seconds;
      if (port.loses(port.in)) continue;
      const double arrives = port.in.free + port.delay;
      const std::uint64_t chain = data_bytes(frame) > 0 ? port.chain + 1 : 0;
      for (const std::size_t to : receivers(frame, from))
        flights_.push({arrives, ++number_, arrives - seconds, to, chain, frame});
    }
  }

  std::vector<std::size_t> receivers(const Frame& frame, std::size_t from) {
    Address to{};
    Address sender{};
    std::copy_n(frame.begin() + kHead, ETH_ALEN, to.begin());
    std::copy_n(frame.begin() + kHead + ETH_ALEN, ETH_ALEN, sender.begin());
    places_[sender] = from;
    if (const auto known = places_.find(to); known != places_.end()) return {known->second};
    std::vector<std::size_t> all;
    for (std::size_t k = 0; k < ports_.size(); ++k)
      if (k != from) all.push_back(k);
    return all;
  }

  // Frames whose time has come go from the switch into their second link, or from there to their host.
  void move_on() {
    while (!flights_.empty() && flights_.top().due <= now()) {
      Flight flight = std::move(const_cast<Flight&>(flights_.top()));  // it is removed at once
      flights_.pop();
      Port& port = ports_[flight.to];
      if (flight.entered >= 0) {
        const std::size_t wire = wire_bytes(flight.frame);
        // Its first packets go on before its last has come.
        port.out.free = std::max(flight.due, std::max(flight.entered, port.out.free) + port.seconds(wire));
        ++port.out.counts.frames;
        port.out.counts.bytes += wire;
        if (port.loses(port.out)) continue;
        flight.due = port.out.free + port.delay;
        flight.entered = -1;
        flights_.push(std::move(flight));
      } else {
        port.chain = std::max(port.chain, flight.chain);
        // A frame that a pulled link doesn't take is lost, as it would be.
        if (send(port.socket, flight.frame.data(), flight.frame.size(), 0) < 0) ++port.lost;
      }
    }
  }

  // False at the input's end.
  bool obey() {
    std::array<char, 4096> text{};
    const ssize_t bytes = read(STDIN_FILENO, text.data(), text.size());
    if (bytes <= 0) return false;
    input_.append(text.data(), static_cast<std::size_t>(bytes));
    for (std::size_t end = 0; (end = input_.find('\n')) != std::string::npos; input_.erase(0, end + 1)) {
      std::istringstream words(input_.substr(0, end));
      std::string command;
      words >> command;
      if (command == "count")
        count();
      else
        std::cout << (command == "set" && set(words) ? "ok" : "what?") << std::endl;
    }
    return true;
  }

  bool set(std::istream& words) {
    std::string name;
    double delay = 0;
    double loss = 0;
    double rate = 0;
    if (!(words >> name >> delay >> loss >> rate) || delay < 0 || rate < 0) return false;
    for (Port& port : ports_) {
      if (port.name != name) continue;
      port.delay = delay;
      port.loss = loss;
      port.rate = rate;
      return true;
    }
    return false;
  }

  void count() const {
    std::uint64_t chain = 0;
    for (const Port& port : ports_) chain = std::max(chain, port.chain);
    std::cout << chain;
    for (const Port& port : ports_)
      std::cout << ' ' << port.in.counts.frames << ' ' << port.in.counts.bytes << ' ' << port.out.counts.frames << ' '
                << port.out.counts.bytes << ' ' << port.lost;
    std::cout << std::endl;
  }

  std::vector<Port> ports_;
  std::map<Address, std::size_t> places_;
  std::priority_queue<Flight> flights_;
  std::uint64_t number_ = 0;
  Frame room_ = Frame(kFrameBytesMax);
  std::string input_;
};

}  // namespace

int main(int count, char** words) {
  // A switch is hardware of its own: it does not wait for its turn among the programs that it connects.
  const sched_param first{.sched_priority = 1};
  sched_setscheduler(0, SCHED_FIFO, &first);
  prctl(PR_SET_TIMERSLACK, 1);
  Switch made({words + 1, words + count});
  std::cout << "ready" << std::endl;
  made.run();
}
