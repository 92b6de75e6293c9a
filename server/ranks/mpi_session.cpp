#include "server/ranks/mpi_session.hpp"

#include <cstdlib>
#include <span>
#include <utility>

#include <mpi.h>
#include <unistd.h>

#include "server/ranks/mpi_comm.hpp"
#include "server/ranks/shared_segments.hpp"

namespace rcb::ranks {

struct MpiSession::State {
  State() : comm(MPI_COMM_WORLD) {}
  MpiComm comm;
};

MpiSession::MpiSession(std::unique_ptr<State> state) : state_(std::move(state)) {}
MpiSession::MpiSession(MpiSession&&) noexcept = default;

MpiSession::~MpiSession() {
  constexpr unsigned kSeconds = 30;
  if (state_) finish(kSeconds);
}

Result<MpiSession> MpiSession::start(int* argc, char*** argv) {
  // A rank that waits in MPI yields its core, which it may share with solvers and with incoming slices.
  ::setenv("OMPI_MCA_mpi_yield_when_idle", "1", 0);
  // Meant for mpirun alone; Open MPI refuses it in a rank, whose folder mpirun names by another variable.
  ::unsetenv("OMPI_MCA_orte_local_tmpdir_base");
  int provided = MPI_THREAD_SINGLE;
  MPI_Init_thread(argc, argv, MPI_THREAD_FUNNELED, &provided);
  if (provided < MPI_THREAD_FUNNELED) {
    MPI_Finalize();
    return Status(Code::unsupported, "this MPI has no thread support", "rcbd needs MPI_THREAD_FUNNELED");
  }
  return MpiSession(std::make_unique<State>());
}

Status MpiSession::allocate_shared_memory() {
  for (const std::string& fault : gather(allocate_shared_segments().message()))
    if (!fault.empty()) return {Code::io_error, fault, "make room there"};
  return {};
}

int MpiSession::rank() const { return state_->comm.rank(); }
int MpiSession::size() const { return state_->comm.size(); }
bool MpiSession::shares_memory() const { return state_->comm.shares_memory(); }
comm::Comm& MpiSession::comm() { return state_->comm; }
void MpiSession::progress() { state_->comm.progress(); }

std::string MpiSession::share(const std::string& text) {
  std::uint64_t bytes = text.size();
  state_->comm.broadcast(std::as_writable_bytes(std::span(&bytes, 1)), 0);
  std::string shared = text;
  shared.resize(bytes);
  state_->comm.broadcast(std::as_writable_bytes(std::span(shared.data(), shared.size())), 0);
  return shared;
}

std::vector<std::string> MpiSession::gather(const std::string& text) {
  Buffer<std::byte> bytes;
  std::vector<std::size_t> sizes;
  state_->comm.all_gather(std::as_bytes(std::span(text)), bytes, sizes);
  std::vector<std::string> texts;
  const char* at = reinterpret_cast<const char*>(bytes.data());
  for (const std::size_t size : sizes) {
    texts.emplace_back(at, size);
    at += size;
  }
  return texts;
}

void MpiSession::finish(unsigned seconds) {
  ::alarm(seconds);  // MPI_Finalize waits for all ranks and has no deadline of its own
  state_.reset();
  MPI_Finalize();
  ::alarm(0);
}

bool started_by_mpirun() { return std::getenv("OMPI_COMM_WORLD_RANK") != nullptr; }

int rank_from_environment() {
  const char* text = std::getenv("OMPI_COMM_WORLD_RANK");
  return text == nullptr ? 0 : std::atoi(text);
}

}  // namespace rcb::ranks
