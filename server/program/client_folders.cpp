#include "server/program/client_folders.hpp"

#include <algorithm>
#include <filesystem>
#include <sstream>
#include <string>
#include <system_error>
#include <vector>

#include <fmt/format.h>
#include <spdlog/spdlog.h>

namespace rcb::server {
namespace {

std::string absolute_text(const std::string& folder) {
  std::error_code error;  // the working directory may be gone; then opening it says so
  const std::filesystem::path path = std::filesystem::absolute(folder, error);
  return error ? folder : path.string();
}

}  // namespace

Result<std::shared_ptr<const io::Roots>> open_client_folders(const Config& config, ranks::MpiSession& mpi,
                                                             const Hosts& hosts) {
  std::string names;
  for (const std::string& folder : config.files_below.empty() ? config.local_files_below : config.files_below)
    names.append(absolute_text(folder)).push_back('\0');
  std::istringstream shared(mpi.share(names));
  auto roots = std::make_shared<io::Roots>();
  // Rank 0's word, since the other machines don't know of a restart.
  const bool may_fail =
      mpi.share(config.restarted || (hosts.several && config.files_below.empty()) ? "warn" : "refuse") == "warn";
  for (std::string folder; std::getline(shared, folder, '\0');) {
    const Status opened = io::Roots().add(folder);
    const std::vector<std::string> faults = mpi.gather(opened.message());
    const auto fault =
        std::find_if(faults.begin(), faults.end(), [](const std::string& text) { return !text.empty(); });
    if (fault == faults.end()) {
      if (Status added = roots->add(folder); !added.ok()) return added;
      continue;
    }
    const std::string& host = hosts.ranks[static_cast<std::size_t>(fault - faults.begin())].host;
    const std::string what = hosts.several ? fmt::format("on {}: {}", host, *fault) : *fault;
    if (!may_fail) return Status(Code::io_error, what, opened.hint());
    if (mpi.rank() == 0) spdlog::warn("clients can't name files below {}: {}", folder, what);
  }
  return std::shared_ptr<const io::Roots>(std::move(roots));
}

}  // namespace rcb::server
