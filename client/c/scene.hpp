// rcbd_scene and rcbd_arrays.
#pragma once

#include <atomic>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "client/c/client.hpp"

struct rcbd_scene final : rcb::c::Handle {
  static constexpr auto kKind = rcb::c::Kind::scene;
  rcbd_scene(rcbd_client& of, std::string called, int threads_of_steps)
      : Handle(kKind), client(of), name(std::move(called)), threads(threads_of_steps) {}
  ~rcbd_scene() override {
    if (opened) static_cast<void>(close());  // else it may be what waited for the turn in vain
  }

  rcb::Status close() override;
  // As rcbd_client::in_turn(). Errors also: invalid_argument (the scene is closed).
  template <typename Work>
  rcb::Status in_turn(const rcb::c::Left& left, const Work& work, const std::atomic<bool>* op = nullptr) {
    const auto with_scene = [&]() -> rcb::Status {
      if (!scene) return {rcb::Code::invalid_argument, "scene '" + name + "' was closed"};
      return work(*scene);
    };
    return client->in_turn(left, with_scene, op);
  }

  rcb::c::Held<rcbd_client> client;
  std::string name;
  int threads;
  bool opened = false;                      // somebody has got the handle
  std::atomic<bool> steps{false};           // a step was begun that isn't done
  std::optional<rcb::client::Scene> scene;  // none: closed. Of who has the client's turn
};

struct rcbd_arrays final : rcb::c::Handle {
  static constexpr auto kKind = rcb::c::Kind::arrays;
  rcbd_arrays() : Handle(kKind) {}

  std::shared_ptr<const void> memory;
  rcbd_positions positions = RCBD_POSITIONS;
};
