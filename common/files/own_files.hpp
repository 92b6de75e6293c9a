// Room `files`: paths, folders and files on disk that belong to this user, locks on them, and who serves an endpoint.
// Nothing here depends on the contents of the files.
//
// This header: directories and files that no other user can replace, redirect or fill. A service's log, token, lock and
// marker are such files. A service that runs as root must not write through a link that somebody else has put into its
// data directory.
//
// The rule is that of OpenSSH's StrictModes, applied to the whole path: every directory on it belongs to root or to
// this user and can't be written by others. A sticky directory that others can write, such as /tmp, is allowed if the
// next component belongs to root or to this user. Symbolic links are followed if root or this user made them.
#pragma once

#include <string>
#include <string_view>

#include "common/base/status.hpp"
#include "common/files/descriptor.hpp"

namespace rcb {

// Makes `path` and its missing parents with mode 0700, and checks the whole path; the directory itself must belong to
// this user. Errors: io_error, not_authorised; the message names the component.
Status make_own_directory(const std::string& path);

// Checks an existing directory in which this user is about to make one. The same rules, but it may be sticky.
Status check_parent_directory(const std::string& path);
// The failure of one of these, whose hint now says which option or variable names another place.
Status naming(std::string_view option, const Status& status);

// True if `path` is a directory of this user, and not a link to one.
bool is_own_directory(const std::string& path);

// Opens a regular file that belongs to this user, has no further hard links and can't be written by others. Flags as
// for open(2); a file that is made gets mode 0600. The directory must have passed make_own_directory(), or the flags
// include O_EXCL. Errors: not_found, io_error, not_authorised (a link, another kind of file, another user's).
Result<Descriptor> open_own_file(const std::string& path, int flags);

// Writes a file of mode 0600 under another name and renames it, so that no reader sees half of it. Errors: io_error.
Status write_own_file(const std::string& path, std::string_view text);

}  // namespace rcb
