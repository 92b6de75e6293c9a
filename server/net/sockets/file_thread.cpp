#include "server/net/sockets/file_thread.hpp"

#include <utility>

namespace rcb::net {

asio::execution_context::id FileThread::id;

FileThread::FileThread(asio::execution_context& context)
    : service(context), context_(static_cast<asio::io_context&>(context)), thread_(std::in_place, kBytesMax) {}

Status FileThread::run(std::function<void()> work, std::function<void()> then) {
  if (!thread_) return {Code::unavailable, "the service has ended"};
  return thread_->post(std::move(work), [&context = context_, then = std::move(then)]() mutable {
    asio::post(context, std::move(then));
  });
}

}  // namespace rcb::net
