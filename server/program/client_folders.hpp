// The folders in which clients may name files, to read them and to write them.
#pragma once

#include <memory>

#include "common/base/status.hpp"
#include "common/io/files/roots.hpp"
#include "server/program/config.hpp"
#include "server/program/hosts.hpp"
#include "server/ranks/mpi_session.hpp"

namespace rcb::server {

// Collective. Opens them as rank 0's options name them; all ranks must have them. After a restart a folder that no
// longer exists is only warned about, and so is the default folder where machines don't share it.
Result<std::shared_ptr<const io::Roots>> open_client_folders(const Config& config, ranks::MpiSession& mpi,
                                                             const Hosts& hosts);

}  // namespace rcb::server
