#include "server/api/with_reports.hpp"

#include <memory>
#include <utility>

namespace rcb::api {
namespace {

// Its destructor gives an answer that somebody waits for: the one that was set, or else a failure.
class Awaited {
 public:
  explicit Awaited(TakeAnswer take)
      : take_(std::move(take)),
        answer_(failed({Code::unavailable, "the service ended before the older step reports were read"})) {}
  Awaited(const Awaited&) = delete;
  Awaited& operator=(const Awaited&) = delete;
  ~Awaited() { take_(std::move(answer_)); }
  void set(Answer answer) { answer_ = std::move(answer); }

 private:
  TakeAnswer take_;
  Answer answer_;
};

}  // namespace

Answer with_reports(const scene::Ledger& ledger, std::uint64_t first, std::uint64_t last,
                    std::function<void(scene::FoundReports, Answer&)> fill) {
  Answer answer = done(wire::Json::object());
  if (ledger.history().in_memory(first)) {
    fill(ledger.history().newest(first, last), answer);
    return answer;
  }
  answer.later = [reading = ledger.history().reading(first, last, ledger.journal()), fill = std::move(fill)](
                     Answer base, TakeAnswer take) {
    auto awaited = std::make_shared<Awaited>(std::move(take));
    auto filled = std::make_shared<Answer>(std::move(base));
    auto whole = std::make_shared<bool>(false);
    const Status begun = reading(
        [fill, filled, whole](scene::FoundReports found) {
          fill(std::move(found), *filled);
          *whole = true;
        },
        [awaited, filled, whole] {
          // Most likely memory has run out.
          awaited->set(*whole ? std::move(*filled)
                              : failed({Code::too_large, "there is no memory for the older step reports",
                                        "ask for fewer at a time, or a page"}));
        });
    if (!begun.ok()) awaited->set(failed(begun));
  };
  return answer;
}

}  // namespace rcb::api
