// IoLoop: a rank's I/O thread. Everything of server/net runs on it; it never calls MPI.
#pragma once

#include <functional>
#include <memory>

namespace boost::asio {
class io_context;
}

namespace rcb::net {

class IoLoop {
 public:
  IoLoop();
  ~IoLoop();  // stops and joins
  IoLoop(const IoLoop&) = delete;
  IoLoop& operator=(const IoLoop&) = delete;

  // Starts the thread.
  void start();
  // Any thread: runs `task` on the I/O thread, soon.
  void post(std::function<void()> task);
  // Any thread but the I/O thread: runs `task` on the I/O thread and waits for its end.
  void run(const std::function<void()>& task);
  // Calls `task` on the I/O thread every `seconds`, from one period after the call, until the loop ends. Before
  // start().
  void every(double seconds, std::function<void()> task);
  // Calls `task` on the I/O thread when SIGTERM, SIGINT or SIGUSR1 comes, each time. Before start().
  void on_signals(std::function<void(int)> task);
  void stop();

  boost::asio::io_context& context();

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace rcb::net
