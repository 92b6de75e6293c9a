#include "server/net/sockets/io_loop.hpp"

#include <csignal>
#include <future>
#include <list>
#include <optional>
#include <thread>
#include <utility>

#include <boost/asio/executor_work_guard.hpp>
#include <spdlog/spdlog.h>

#include "server/net/sockets/asio.hpp"

namespace rcb::net {

struct IoLoop::State {
  asio::io_context context{1};
  std::optional<asio::executor_work_guard<asio::io_context::executor_type>> work{context.get_executor()};
  std::list<Timer> tickers;
  std::optional<asio::signal_set> signals;
  std::thread thread;

  void tick(Timer& timer, double seconds, const std::shared_ptr<std::function<void()>>& task) {
    timer.expires_after(duration_of(seconds));
    timer.async_wait([this, &timer, seconds, task](error_code error) {
      if (error) return;
      (*task)();
      tick(timer, seconds, task);
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

IoLoop::IoLoop() : state_(std::make_unique<State>()) {}

IoLoop::~IoLoop() { stop(); }

void IoLoop::start() {
  state_->thread = std::thread([this] {
    // An exception in a handler is a bug or a failed allocation: what that handler served is lost, everything else goes
    // on.
    for (bool ended = false; !ended;) {
      try {
        state_->context.run();
        ended = true;
      } catch (const std::exception& fault) {
        spdlog::error("an internal fault on the I/O thread: {}", fault.what());
      }
    }
  });
}

void IoLoop::post(std::function<void()> task) { asio::post(state_->context, std::move(task)); }

void IoLoop::run(const std::function<void()>& task) {
  std::promise<void> done;
  post([&] {
    task();
    done.set_value();
  });
  done.get_future().wait();
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
}

asio::io_context& IoLoop::context() { return state_->context; }

}  // namespace rcb::net
