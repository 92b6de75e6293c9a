// IoLoop: a rank's I/O thread, on which the code of server/net runs unless its header says otherwise. It never calls
// MPI.
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
  // Any thread but the I/O thread: runs `task` on the I/O thread and waits for its end. Throws what `task` throws.
  void run(const std::function<void()>& task);
  // Before start(): calls `task` on the I/O thread every `seconds` until the loop ends, first after one period.
  void every(double seconds, std::function<void()> task);
  // Before start(): calls `task` on the I/O thread at every SIGTERM, SIGINT or SIGUSR1.
  void on_signals(std::function<void(int)> task);
  void stop();

  boost::asio::io_context& context();

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace rcb::net
