// DataHub: the DataPlane over doorbells. It calls rank 0's own port directly and sends every other rank a peer message.
#pragma once

#include "server/net/data/data_port.hpp"
#include "server/net/peers/doorbell.hpp"

namespace rcb::net {

class DataHub final : public DataPlane {
 public:
  DataHub(DoorbellHub& doorbells, DataPort& own, int ranks);
  void open(const PushTicket& ticket, std::span<const std::optional<std::uint64_t>> counts) override;
  void drop(const PushId& id) override;

 private:
  DoorbellHub& doorbells_;
  DataPort& own_;
  int ranks_;
};

// Carries out a peer message of DataHub on another rank's port.
void apply_hub_message(DataPort& port, const wire::Json& message);

}  // namespace rcb::net
