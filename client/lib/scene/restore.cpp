// Scene after its service was restarted and has lost the particles: what the client keeps for this case, and the push
// that restores them.
#include <algorithm>

#include <fmt/format.h>

#include "client/lib/scene/scene.hpp"

namespace rcb::client {
void Scene::State::lose() {
  lost_ = true;
  pushed_ = false;
  cuts_.known.reset();
  counted_.forget();
  if (!known_) known_ = std::move(parts_);
  parts_.clear();
}

void Scene::State::keep_weights(std::span<const double> weights) {
  if ((session().outlive() || when_needed_) && weights.data() != weights_.data())
    weights_.assign(weights.begin(), weights.end());
}

Status Scene::State::base_lost(const std::string& why) const {
  return {Code::base_lost,
          fmt::format("the service at {} was started again and has lost the particles of scene '{}': {}",
                      session().endpoint(), name_, why),
          "push all positions with step()"};
}

void Scene::State::forget_lost_if_replaced(const StepRequest& ask) {
  if (!lost_ || !ask.whole()) return;
  const auto& ids = ask.options.ids;
  const bool same_ids = ids.empty() || ids_.empty() || std::equal(ids.begin(), ids.end(), ids_.begin(), ids_.end());
  if (ask.positions.count == count_ && same_ids) return;
  forget_rows();
  has_ids_ = false;
  weights_.clear();
  told_ = answered_ = began_ = false;
  count_ = ask.positions.count;
}

Result<StepRequest> Scene::State::with_all_particles(const StepRequest& ask) const {
  if (!ask.whole())
    return base_lost(fmt::format("of {} particles this push has the positions of {}", count_, ask.positions.count));
  const bool own_ids = !ask.options.ids.empty() || !ids_.empty();
  if (has_ids_ && !own_ids && count_ > 0)
    return base_lost("they had ids of their own, which this client doesn't know: give them, too");
  if (has_weights_ && ask.options.weights.empty() && weights_.size() != count_)
    return base_lost("they had weights, which this client doesn't know: give them, too");
  StepRequest whole = ask;
  whole.moved = StepRequest::Moved::all;
  whole.options.moved.reset();
  if (whole.options.ids.empty()) whole.options.ids = ids_;
  if (has_weights_ && whole.options.weights.empty()) whole.options.weights = weights_;
  return whole;
}

Status Scene::State::restore(const StepRequest& whole, const Retry& retry) {
  restored_ = true;
  StepRequest ask = whole;
  ask.options.removed = {};
  ask.options.inserted = nullptr;
  ask.options.step_seconds.reset();
  ask.options.want_parts = ask.options.want_changes = false;
  const std::int64_t step = *last_step_;
  const auto known = known_;
  const bool told = told_;
  by_id_ = shared_ = by_shared_memory(ask, retry);
  if (Status status = ready(count_, ask.options.ids, retry, !by_id_); !status) return status;
  const auto frame = push(ask, step, std::nullopt, retry);
  if (!frame) return frame.status();
  auto answer = read_answer(*frame, step, true);
  if (!answer) return answer.status();
  const auto finished = finish(*frame, std::move(*answer), ask, retry);
  known_ = known;
  told_ = told;
  return finished.status();
}

}  // namespace rcb::client
