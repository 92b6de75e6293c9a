// Where a service lives: its default socket, its data directory and the files in it. Defined in one place, because the
// service, the launcher and every client must arrive at the same paths.
//
// Invariants
// 1. Two endpoints never share a default data directory: its name is the endpoint, escaped injectively (long names end
//    in a hash of the endpoint).
// 2. The default directories are private: 0700, owned by this user, no symbolic link.
#pragma once

#include <string>
#include <string_view>
#include <system_error>
#include <vector>

#include "common/base/status.hpp"

namespace rcb {

// Files in the data directory.
inline constexpr std::string_view kTokenFile = "token";                   // 64 hex digits, mode 0600
inline constexpr std::string_view kCleanShutdownFile = "clean-shutdown";  // left by a service that is told to end
inline constexpr std::string_view kLogFile = "rcbd.log";                  // the launcher writes rcbd's stderr here
inline constexpr std::string_view kLockFile = "lock";                     // a LockFile whose note is an EndpointNote

// Environment variable that names the job's folder, which holds Open MPI's session files, sockets and, where System V's
// limits are too low, the memory that ranks share.
inline constexpr const char* kJobFolderVariable = "RCBD_JOB_FOLDER";
// The name of the machine whose launcher started the job, where rank 0 must be.
inline constexpr const char* kLauncherHostVariable = "RCBD_LAUNCHER_HOST";
inline constexpr std::string_view kJobFolderPrefix = "rcbd-";  // how the folder's name begins
inline constexpr std::string_view kReadyFile = "ready";        // made in the job's folder once the service answers

// The longest path that fits a socket address.
inline constexpr std::size_t kSocketPathMax = 107;

// $XDG_RUNTIME_DIR/rcbd; /tmp/rcbd-UID if that variable doesn't name, by an absolute path, a folder of this user's.
std::string default_socket_directory();
// The path of rcbd.sock in that directory.
std::string default_socket_path();

// $XDG_STATE_HOME/rcbd/E, else ~/.local/state/rcbd/E, where E is the endpoint ("unix:PATH" or "HOST:PORT"; a bare
// path counts as unix:) with every character outside [A-Za-z0-9._-] escaped. A relative path is made absolute first.
std::string data_directory_for(std::string_view endpoint);

// As make_own_directory() (own_files.hpp), for a directory that only we use. One that exists is made inaccessible to
// others (mode 0700), and refused if it is a link. Errors: io_error, not_authorised.
Status make_private_directory(const std::string& path);
// For output that the user asks for: makes `path` and its missing parents; uses an existing directory unchanged.
// Errors: io_error.
Status make_directory(const std::string& path);

// What a directory holds, as far as it can be read. fault: why no further. A loop over std::filesystem's iterator
// throws where reading fails half-way.
std::vector<std::string> names_in(const std::string& directory, std::error_code& fault);

// This machine's name, as gethostname(2) has it.
std::string host_name();
// The machine of this process, as far as its sockets reach: the same for two processes if and only if each reaches the
// other's Unix sockets. Containers may share a name, and namespaces a boot.
std::string machine_key();

// dir + "/" + name.
std::string join_path(std::string_view directory, std::string_view name);

}  // namespace rcb
