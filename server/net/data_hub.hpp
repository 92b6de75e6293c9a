// DataHub: the data plane over doorbells. Rank 0's own port is told at once, the others by a word each.
#pragma once

#include "server/net/control.hpp"
#include "server/net/data_port.hpp"
#include "server/net/doorbell.hpp"

namespace rcb::net {

class DataHub final : public DataPlane {
 public:
  DataHub(DoorbellHub& doorbells, DataPort& own, int ranks);
  void open(const PushTicket& ticket, std::span<const std::uint64_t> counts) override;
  void drop(const PushId& id) override;

 private:
  DoorbellHub& doorbells_;
  DataPort& own_;
  int ranks_;
};

// What another rank's port does with rank 0's words.
void follow_hub(DataPort& port, const wire::Json& news);

}  // namespace rcb::net
