// Network: what the owner of a service says of the network that a TCP listener is on.
#pragma once

namespace rcb::net {

enum class Network {
  loopback,  // none: only this machine reaches the listener
  trusted,   // nobody on it reads or alters what isn't theirs
};

}  // namespace rcb::net
