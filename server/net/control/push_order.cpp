#include "server/net/control/push_order.hpp"

#include <algorithm>
#include <utility>

namespace rcb::net {

using wire::Json;

namespace {

Json block_json(const Block& push) {
  const PushTerms& terms = push.terms;
  Json block{
      {"seat", push.seat}, {"n", terms.n}, {"way", name_of(terms.way)}, {"dtype", terms.is_float32 ? "<f4" : "<f8"}};
  if (!terms.counts.empty()) block["counts"] = terms.counts;
  if (push.number != 0) block["number"] = push.number;
  if (terms.from_memory())
    block.update({{"session", terms.id.session}, {"memory", push.memory}, {"sockets", terms.by_socket}});
  return block;
}

// What all pushes say together, but for those without rows.
class Together {
 public:
  explicit Together(const scene::SceneState& scene) : first_(!scene.step), known_(scene.step && scene.n > 0) {
    all_.ids = scene.ids;
    all_.weights = scene.weights;
  }

  void add(const PushTerms& terms) {
    all_.n += terms.n;
    if (!first_) all_.inserted += terms.inserted;
    if (!first_) all_.removed += terms.removed;
    if (terms.step_seconds) all_.step_seconds = std::max(*terms.step_seconds, all_.step_seconds.value_or(0));
    if (terms.cuts_known && all_.cuts_known.value_or(*terms.cuts_known) != *terms.cuts_known)
      all_.cuts_known.emplace();  // no cuts are those that all of them know
    else if (terms.cuts_known)
      all_.cuts_known = terms.cuts_known;
    if (terms.n > 0)
      add_rows(terms);
    else if (!known_ && rows_ == 0)
      all_.weights = all_.weights || terms.weights;
  }

  const PushTerms& terms() const { return all_; }

  Json json() const {
    Json json{{"n", all_.n},
              {"weights", all_.weights},
              {"ids", all_.ids},
              {"inserted", all_.inserted},
              {"removed", all_.removed}};
    if (all_.drifted) json["drifted"] = *all_.drifted;
    if (all_.step_seconds) json["step_seconds"] = *all_.step_seconds;
    if (const auto& cuts = all_.cuts_known)
      json["cuts_known"] = {{"epoch", cuts->epoch}, {"hash", wire::hex64(cuts->hash)}};
    return json;
  }

 private:
  void add_rows(const PushTerms& terms) {
    const bool first = rows_++ == 0;
    all_.ids = terms.ids;
    all_.weights = terms.weights;
    if (!terms.drifted || (!first && !all_.drifted))
      all_.drifted.reset();
    else
      all_.drifted = *terms.drifted + all_.drifted.value_or(0);
  }

  bool first_;    // nothing came or went before it
  bool known_;    // whether there are weights
  int rows_ = 0;  // pushes that have some
  PushTerms all_;
};

}  // namespace

PushOrder order_of(const OpenStep& step, const scene::Ledger& ledger) {
  PushOrder order;
  OrderOptions& options = order.options;
  Together all(ledger.now());
  Json blocks = Json::array();
  for (const auto& push : step.shares) {
    const PushTerms& terms = push->terms;
    all.add(terms);
    options.sessions.push_back(scene::session_key(terms.id.session));
    options.charged_bytes += std::exchange(push->charged_bytes, 0);
    if (terms.n > 0) blocks.push_back(block_json(*push));
    if (!push->slice) continue;
    push->slice->seat = static_cast<int>(push->seat);
    options.slices.push_back(std::move(*push->slice));
  }
  options.changes = step.scene;
  order.request = all.json();
  order.request.update({{"command", "push"},
                        {"scene", step.scene},
                        {"step", step.number},
                        {"seats", step.shares.size()},
                        {"blocks", std::move(blocks)}});
  if (ledger.now().others) order.request["counted_ids"] = *ledger.now().id_sum;
  if (Json terms = to_json(ledger.terms(all.terms().step_seconds)); !terms.empty())
    order.request["terms"] = std::move(terms);
  return order;
}

}  // namespace rcb::net
