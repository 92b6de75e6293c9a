// Network: what the owner of a service says about the network of a TCP listener.
#pragma once

namespace rcb::net {

enum class Network {
  loopback,  // none: only this machine reaches the listener
  trusted,   // nobody on it reads or alters others' data
};

}  // namespace rcb::net
