// Directories and files that no other user can replace, redirect or fill: where a service's log, token, lock and marker
// lie. A service that runs as root must not write through a link that somebody else has put into its data directory.
//
// The rule is that of OpenSSH's StrictModes, for the whole path: every directory on it belongs to root or to this user
// and can't be written by others; in one that can and is sticky, such as /tmp, the next must belong to root or to this
// user. Symbolic links on the way are followed if root or this user has made them.
#pragma once

#include <string>

#include "common/base/status.hpp"

namespace rcb {

// Makes `path` (and parents that are missing) with mode 0700 if it isn't there, and checks the whole path; the
// directory itself must be this user's. Errors: io_error, not_authorised; they name the component.
Status make_own_directory(const std::string& path);

// The same check of a directory that is there and in which this user is about to make one; it may be sticky.
Status check_parent_directory(const std::string& path);

// A directory of this user's is there, and no link to one.
bool is_own_directory(const std::string& path);

// Opens a regular file of this user that has one name and can't be written by others; flags as for open(2), a file that
// is made gets mode 0600. The directory must be one that make_own_directory() has taken, or the file be made with
// O_EXCL. Errors: not_found, io_error, not_authorised (a link, another kind of file, another user's).
Result<int> open_own_file(const std::string& path, int flags);

}  // namespace rcb
