// rcbd_op and rcbd_result: a step that is being made, and what it told.
#pragma once

#include <atomic>
#include <cstdint>
#include <vector>

#include "client/c/scene.hpp"

struct rcbd_result final : rcb::c::Handle {
  static constexpr auto kKind = rcb::c::Kind::result;
  explicit rcbd_result(const rcb::client::StepOptions& options)
      : Handle(kKind), has_parts(options.want_parts), has_changed(options.want_changes) {}

  void take(rcb::client::StepResult&& step);

  rcb::client::StepResult told;
  bool has_parts, has_changed;
  // By column, as arrays of the interface are.
  std::vector<std::int64_t> changed_rows, leaving_rows;
  std::vector<std::int32_t> changed_parts, leaving_seats;
};

struct rcbd_op final : rcb::c::Handle {
  static constexpr auto kKind = rcb::c::Kind::op;
  rcbd_op(rcbd_scene& of, const rcb::client::Positions& at, const rcb::client::StepOptions& with)
      : Handle(kKind), scene(of), positions(at), options(with) {}
  ~rcbd_op() override;

  // Makes the step. In the worker's thread.
  void run();

  rcb::c::Held<rcbd_scene> scene;
  rcb::client::Positions positions;
  rcb::client::StepOptions options;
  std::atomic<bool> cancelled{false};
  bool begun = false;  // the worker has it, and sets `done`
  bool done = false;   // of the worker's mutex; nothing below changes any more then
  rcb::Status status;
  rcbd_result* result = nullptr;  // with one holder, this
};
