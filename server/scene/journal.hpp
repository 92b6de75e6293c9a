// Journal: what makes a scene outlive the service's process: a folder below DATA/scenes/ for each incarnation of a
// scene, with the files `state`, `cuts` (JournalSlots) and `steps.K` (JournalReports). What the bytes mean is the
// owner's business.
//
// Invariants
// 1. A process that dies leaves the newest state and cuts that were put, or those before; and the reports up to the one
//    that was being appended. Nothing is synced: what the machine had not written when it went down is lost.
// 2. At a commit the owner puts new cuts first, then the state, then appends the report. So a start may find cuts that
//    no state knows yet (hold_older_cuts() then), and a state that is one report ahead: it holds the last report, which
//    is appended then. Whatever else is missing is lost. Reports that are ahead of the state, because it could not be
//    put on a full disk, are to be forgotten: keep_below().
// 3. What is read back is hostile until its checksum holds, and remains untrusted input for the owner.
// 4. No function here waits but for the file system; those that ask it for room say io_error where there is none, and
//    may be called again.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "common/base/status.hpp"
#include "server/scene/journal_reports.hpp"
#include "server/scene/journal_slots.hpp"
#include "server/scene/storage.hpp"

namespace rcb::scene {

struct SceneFolder {
  std::string name;
  std::uint64_t incarnation = 0;
  // DATA/scenes/NAME.0123456789abcdef
  std::string path(const std::string& data) const;
};

// The folders of a data directory. One whose state isn't there, without any fault, was being made or removed when the
// service ended, and is to be removed. Errors: io_error.
Result<std::vector<SceneFolder>> scene_folders(const Storage& storage, const std::string& data);
// Renames DATA/scenes to DATA/scenes.old-N, N = 1, 2, ..., and returns that path; empty if there is none.
Result<std::string> set_scenes_aside(Storage& storage, const std::string& data);
// Removes a folder, the state first. Errors: io_error.
Status remove_scene_folder(Storage& storage, const std::string& path);

// What open() found.
struct JournalFound {
  std::vector<std::string> states;  // the newest first; at most two
  std::vector<std::string> cuts;    // likewise
  std::vector<std::string> faults;  // what is wrong, each a sentence with the file's path
};

class Journal {
 public:
  using Visit = JournalReports::Visit;

  // storage: outlives this. Files are made with the first put and append. Errors: already_exists, io_error,
  // not_authorised.
  static Result<Journal> create(Storage& storage, const std::string& data, const SceneFolder& scene);
  // Errors: io_error, not_authorised (others may write there). Damaged files are no error, but `found` tells.
  static Result<Journal> open(Storage& storage, const std::string& data, const SceneFolder& scene, JournalFound& found);

  // Overwritten in place: needs no room unless the bytes outgrow the file. Errors: io_error, too_large; what was put
  // before stands then.
  Status put_state(std::string_view bytes) { return state_.put(bytes); }
  Status put_cuts(std::string_view bytes) { return cuts_.put(bytes); }
  // The state names the older ones of the cuts found, which must not be overwritten next.
  void hold_older_cuts() { cuts_.hold_older(); }

  // number: how many reports the scene had before this one; above those of all that are kept. Errors: io_error (the
  // report is lost, later ones may be kept), too_large.
  Status append(std::uint64_t number, std::string_view report) { return reports_.append(number, report); }
  // Calls visit(number, report) for those of the reports [first, last) that are kept, ascending. Errors: io_error.
  Status read(std::uint64_t first, std::uint64_t last, const Visit& visit) const {
    return reports_.read(first, last, visit);
  }
  // To read them on another thread, as of now.
  JournalReports reader() const { return reports_.reader(); }
  // Forgets the reports from `number` on. Errors: io_error.
  Status keep_below(std::uint64_t number) { return reports_.keep_below(number); }
  std::uint64_t reports() const { return reports_.count(); }     // how many are kept
  std::uint64_t next_report() const { return reports_.next(); }  // above the number of the last one kept

  // The scene is dropped. Nothing else may be called then. Errors: io_error (an open() finds no state even so, if that
  // much could be removed).
  Status remove();

 private:
  Journal(Storage& storage, std::string path, std::uint64_t seed);

  Storage* storage_;
  std::string path_;
  JournalSlots state_;
  JournalSlots cuts_;
  JournalReports reports_;
};

}  // namespace rcb::scene
