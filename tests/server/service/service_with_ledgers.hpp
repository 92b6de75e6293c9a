// A service as its clients know it: the ranks, and on rank 0 the ledgers, which the coordinator keeps.
#pragma once

#include <chrono>
#include <cstdlib>
#include <future>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "server/api/commands.hpp"
#include "server/api/cut_arrays.hpp"
#include "server/api/ledger_answers.hpp"
#include "server/scene/ledger.hpp"
#include "server/service/service.hpp"

namespace rcb::testing {

using service::PushSlice;
using service::Response;
using wire::Json;

// The answer with what is read beside the engine; the test fails where that doesn't come in time.
inline Response complete(Response response) {
  std::promise<Response> whole;
  auto coming = whole.get_future();
  api::complete(std::move(response), [&whole](Response answer) { whole.set_value(std::move(answer)); });
  if (coming.wait_for(std::chrono::seconds(60)) == std::future_status::ready) return coming.get();
  ADD_FAILURE() << "no answer";
  std::abort();  // whoever answers later would find no promise
}

// Every rank makes one. What the coordinator does: commands of the ledger are answered by rank 0 alone, a push is told
// what the policy needs, a step that this session has committed is answered without an order, and the ledger takes in
// what an order has done.
class Service {
 public:
  Service(comm::Comm& comm, const Clock& clock, service::ServiceOptions options = {})
      : comm_(comm), service_(comm, clock, std::move(options)) {}
  // Its scenes last in this storage, which is rank 0's.
  Service(comm::Comm& comm, const Clock& clock, std::shared_ptr<scene::Storage> storage)
      : comm_(comm), service_(comm, clock), ledgers_({1000, root() ? std::move(storage) : nullptr, "data"}) {}

  // Collective. Takes up the scenes in the storage.
  scene::Restored restore() {
    const scene::Restored restored = ledgers_.restore();
    std::vector<const scene::Ledger*> found;
    for (const auto& [name, ledger] : ledgers_) found.push_back(&ledger);
    std::uint64_t count = found.size();
    comm_.all_max({&count, 1});
    for (std::size_t k = 0; k < count; ++k) {
      std::vector<PushSlice> slices;
      if (root() && found[k]->now().tree) slices.push_back({.arrays = api::cut_arrays(*found[k]->now().tree)});
      const std::string order = everywhere(root() ? api::restore_order(*found[k]).dump() : "");
      const Response response = service_.execute(Json::parse(order), std::move(slices));
      EXPECT_TRUE(response.status.ok()) << response.status.message();
    }
    return restored;
  }
  // Rank 0's.
  const scene::Ledgers& ledgers() const { return ledgers_; }

  // Collective. Only rank 0 returns the answer.
  Response execute(Json request, std::vector<PushSlice> slices = {}, const service::OrderTerms& terms = {}) {
    const std::string command = request.at("command");
    const std::string scene = request.value("scene", "");
    const api::CommandInfo* info = api::find_command(command);
    if (info != nullptr && info->runs_on == api::RunsOn::ledger) return root() ? answer(scene, request) : Response();
    if (command == "push") {
      if (const std::string report = repeated(scene, request); !report.empty())
        return root() ? api::done(Json::parse(report)) : Response();
      add_terms(scene, request);
    }
    Response response = service_.execute(request, std::move(slices), terms);
    if (response.change) take_change(response, request.value("session", "s"));
    if (command == "scene.create" && root() && response.status.ok())
      response.json = api::describe(*ledgers_.find(scene), comm_.size()).json;
    return response;
  }

 private:
  bool root() const { return comm_.rank() == 0; }

  Response answer(const std::string& scene, const Json& request) const {
    const scene::Ledger* ledger = ledgers_.find(scene);
    if (ledger == nullptr) return api::failed({Code::not_found, "no scene '" + scene + "'"});
    return complete(api::answer_from(*ledger, request, comm_.size()));
  }

  // The answer to who brings the last step again; else "".
  std::string repeated(const std::string& scene, const Json& request) {
    const scene::Ledger* ledger = ledgers_.find(scene);  // none on the other ranks
    const bool again = ledger != nullptr && ledger->was_in_last(request.value("session", "s"), request.at("step"));
    return everywhere(again ? api::repeated(*ledger) : "");
  }

  void add_terms(const std::string& scene, Json& request) {
    std::string text;
    if (const scene::Ledger* ledger = ledgers_.find(scene)) {
      const auto seconds = request.find("step_seconds");
      const bool told = seconds != request.end() && seconds->is_number();
      text = to_json(ledger->terms(told ? std::optional(seconds->get<double>()) : std::nullopt)).dump();
    }
    text = everywhere(std::move(text));
    if (!text.empty()) request["terms"] = Json::parse(text);
  }

  // Rank 0's text.
  std::string everywhere(std::string text) {
    std::uint64_t size = text.size();
    comm_.all_max({&size, 1});
    text.resize(size);
    if (size > 0) comm_.broadcast(std::as_writable_bytes(std::span(text)), 0);
    return text;
  }

  void take_change(Response& response, const std::string& session) {
    if (auto* stepped = std::get_if<scene::Stepped>(&response.change->event))
      stepped->sessions = {scene::session_key(session)};
    const scene::Ledger* ledger = ledgers_.find(response.change->scene);
    const Json previous_step = ledger != nullptr && ledger->now().step ? Json(*ledger->now().step) : Json();
    const scene::StepReport* report = ledgers_.take(*response.change, ++incarnations_);
    if (report == nullptr) return;
    response.json["report"] = to_json(*report);
    if (response.json.contains("previous_step")) response.json["previous_step"] = previous_step;
  }

  comm::Comm& comm_;
  service::Service service_;
  scene::Ledgers ledgers_{{.keep_reports = 1000}};
  std::uint64_t incarnations_ = 0;
};

}  // namespace rcb::testing
