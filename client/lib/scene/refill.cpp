// Scene after its service was started again: the ranks hold no particles until a client has brought them.
#include <fmt/format.h>

#include "client/lib/scene/scene.hpp"

namespace rcb::client {

void Scene::State::keep_weights(std::span<const double> weights) {
  if ((session().outlive() || when_needed_) && weights.data() != weights_.data())
    weights_.assign(weights.begin(), weights.end());
}

Status Scene::State::base_lost(const std::string& why) const {
  return {Code::base_lost,
          fmt::format("the service at {} was started again, and its ranks hold no particles of scene '{}': {}",
                      session().endpoint(), name_, why),
          "push all positions with step()"};
}

Result<StepRequest> Scene::State::with_all_particles(const StepRequest& ask) const {
  if (!ask.whole())
    return base_lost(fmt::format("of {} particles this push has the positions of {}", count_, ask.positions.count));
  if (has_ids_ && ask.options.ids.empty() && ids_.empty() && count_ > 0)
    return base_lost("they have ids of their own, which this client doesn't know: give them, too");
  if (has_weights_ && ask.options.weights.empty() && weights_.size() != count_)
    return base_lost("they have weights, which this client doesn't know: give them, too");
  StepRequest whole{ask.positions, {}, StepRequest::Moved::all, {}};
  whole.options.ids = ask.options.ids.empty() ? std::span<const std::int64_t>(ids_) : ask.options.ids;
  if (has_weights_)
    whole.options.weights = ask.options.weights.empty() ? std::span<const double>(weights_) : ask.options.weights;
  return whole;
}

Status Scene::State::refill(const StepRequest& ask, const Retry& retry) {
  const auto whole = with_all_particles(ask);
  if (!whole) return whole.status();
  session().notice(
      fmt::format("{} was started again, and gets the particles of scene '{}' anew", session().endpoint(), name_));
  shared_ = by_id_ = by_shared_memory(*whole, retry);
  if (Status status = ready(count_, whole->options.ids, retry, !by_id_); !status) return status;
  const auto frame = push(*whole, *last_step_, std::nullopt, retry);
  if (frame.status().code() == Code::stale_step) {  // another client was quicker
    generation_ = 0;
    return {Code::stale_plan, frame.status().message(), frame.status().hint()};
  }
  if (!frame) return frame.status();
  filled_ = older_ = true;
  plan_.reset();
  return {};
}

Result<Frame> Scene::State::ask_for_answer(const StepRequest& ask, std::int64_t step, const Retry& retry) {
  wire::Json begin{{"command", "push.begin"},
                   {"scene", name_},
                   {"session", session().number()},
                   {"step", step},
                   {"attempt", session().next_attempt()},
                   {"n", count_},
                   {"slices", 0},
                   {"order", "id"},
                   {"moved", "none"}};
  if (uses_cuts(ask)) begin["cuts_known"] = cuts_.known_json();
  return session().call_once(std::move(begin), retry);
}

}  // namespace rcb::client
