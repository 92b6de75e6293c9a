// Which connections are encrypted: one rule for both sides.
#pragma once

struct sockaddr;

namespace rcb::tls {

// Whether a connection to this address of a service may come from another machine: it is neither a Unix socket's nor
// one of loopback (127.0.0.0/8, ::1, and 127.0.0.0/8 as a listener on [::] sees it).
bool off_loopback(const sockaddr& address);

}  // namespace rcb::tls
