// Where a service lives: its default socket, its data directory and the files in it. One place, because the
// service, the launcher and every client must come to the same answer.
//
// Invariants
// 1. Two endpoints never share a default data directory: the name is an injective escape of the endpoint.
// 2. The default directories are private: 0700, owned by this user, no symbolic link.
#pragma once

#include <string>
#include <string_view>

#include "common/base/status.hpp"

namespace rcb {

// In the data directory.
inline constexpr std::string_view kTokenFile = "token";                   // 64 hex digits, mode 0600
inline constexpr std::string_view kCleanShutdownFile = "clean-shutdown";  // left by a service that ended as told
inline constexpr std::string_view kLogFile = "rcbd.log";                  // the launcher writes rcbd's stderr here
inline constexpr std::string_view kLockFile = "lock";                     // LockFile, an EndpointNote in it

// Names the job's own folder in the environment of its ranks: Open MPI's session files and the shared memory.
inline constexpr const char* kJobFolderVariable = "RCBD_JOB_FOLDER";
inline constexpr std::string_view kJobFolderPrefix = "rcbd-";  // of the folder's own name
inline constexpr std::string_view kReadyFile = "ready";        // in it, once the service answers

// The longest path that fits a socket address.
inline constexpr std::size_t kSocketPathMax = 107;

// $XDG_RUNTIME_DIR/rcbd, without that variable (or with a relative one) /tmp/rcbd-UID.
std::string default_socket_directory();
// rcbd.sock in it.
std::string default_socket_path();

// $XDG_STATE_HOME/rcbd/E, else ~/.local/state/rcbd/E, where E is the endpoint ("unix:PATH" or "HOST:PORT"; a bare
// path counts as unix:) with every character outside [A-Za-z0-9._-] escaped. A relative path is made absolute first.
std::string data_directory_for(std::string_view endpoint);

// As make_own_directory() (own_files.hpp), for a directory that only we use: one that is there is closed to others, and
// refused if it is a link. Errors: io_error, not_authorised.
Status make_private_directory(const std::string& path);
// For what the user asks to be written: makes `path` and its parents if they aren't there; takes a directory that is
// there as it is. Errors: io_error.
Status make_directory(const std::string& path);

// dir + "/" + name.
std::string join_path(std::string_view directory, std::string_view name);

}  // namespace rcb
