#include "server/net/sockets/io_loop.hpp"

#include <csignal>
#include <future>
#include <list>
#include <optional>
#include <system_error>
#include <thread>
#include <utility>

#include <boost/asio/executor_work_guard.hpp>
#include <malloc.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include "server/net/sockets/asio.hpp"
#include "server/net/sockets/file_thread.hpp"
#include "server/net/sockets/large_json.hpp"

namespace rcb::net {

struct IoLoop::State {
  asio::io_context context{1};
  std::optional<asio::executor_work_guard<asio::io_context::executor_type>> work{context.get_executor()};
  std::list<Timer> tickers;
  std::optional<asio::signal_set> signals;
  std::thread thread;

  // An exception in a handler is a bug or a failed allocation: what that handler served is lost, everything else goes
  // on.
  void run() {
    for (bool ended = false; !ended;) {
      try {
        context.run();
        ended = true;
      } catch (const std::exception& fault) {
        spdlog::error("an internal fault on the I/O thread: {}", fault.what());
      }
    }
  }

  void tick(Timer& timer, double seconds, const std::shared_ptr<std::function<void()>>& task) {
    timer.expires_after(duration_of(seconds));
    timer.async_wait([this, &timer, seconds, task](error_code error) {
      if (error) return;
      tick(timer, seconds, task);  // first, since the task may throw
      (*task)();
    });
  }

  void wait_signal(const std::shared_ptr<std::function<void(int)>>& task) {
    signals->async_wait([this, task](error_code error, int number) {
      if (error) return;
      (*task)(number);
      wait_signal(task);
    });
  }
};

namespace {

// The C library gives each thread that allocates 64 MiB of addresses of its own, which count where the process's memory
// is limited (ulimit -v). The engine's and this thread's are enough: those beside them allocate little.
void share_memory_among_threads() {
#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)  // which have allocators of their own
  ::mallopt(M_ARENA_MAX, 2);
#endif
}

}  // namespace

// The threads beside this one are started now: later the system may give none.
IoLoop::IoLoop() : state_(std::make_unique<State>()) {
  share_memory_among_threads();
  FileThread::of(state_->context);
  LargeJson::of(state_->context);
}

IoLoop::~IoLoop() { stop(); }

void IoLoop::start() {
  try {
    state_->thread = std::thread([this] { state_->run(); });
  } catch (const std::system_error& fault) {
    spdlog::critical("the service can start no thread: {}; raise the limit on processes (ulimit -u, pids.max)",
                     fault.code().message());
    ::_exit(1);  // as where a rank is lost: mpirun ends the job
  }
}

void IoLoop::post(std::function<void()> task) { asio::post(state_->context, std::move(task)); }

void IoLoop::run(const std::function<void()>& task) {
  const auto shared = std::make_shared<std::packaged_task<void()>>(task);
  auto done = shared->get_future();
  post([shared] { (*shared)(); });
  done.get();
}

void IoLoop::every(double seconds, std::function<void()> task) {
  Timer& timer = state_->tickers.emplace_back(state_->context);
  state_->tick(timer, seconds, std::make_shared<std::function<void()>>(std::move(task)));
}

void IoLoop::on_signals(std::function<void(int)> task) {
  state_->signals.emplace(state_->context, SIGTERM, SIGINT, SIGUSR1);
  state_->wait_signal(std::make_shared<std::function<void(int)>>(std::move(task)));
}

void IoLoop::stop() {
  state_->work.reset();
  state_->context.stop();
  if (state_->thread.joinable()) state_->thread.join();
  FileThread::of(state_->context).finish();
}

asio::io_context& IoLoop::context() { return state_->context; }

}  // namespace rcb::net
