// Credentials: by what clients over TCP recognise the service, and what protects what they exchange with it.
#pragma once

#include <memory>
#include <string>

#include "common/auth/proof.hpp"
#include "common/tls/identity.hpp"

namespace rcb::net {

// What protects what travels to and from other machines.
enum class Network {
  loopback,   // nothing: only this machine may reach a listener
  encrypted,  // TLS
  trusted,    // the word of the service's owner that nobody on the network reads or alters others' data
};

struct Credentials {
  std::string token;                              // that both sides know; says whether the network is trusted
  std::shared_ptr<const tls::Identity> identity;  // none: this process can't speak TLS

  Network network() const {
    if (auth::trusts_network(token)) return Network::trusted;
    return identity ? Network::encrypted : Network::loopback;
  }
};

}  // namespace rcb::net
