#include "tests/bench/peers/multijagged.hpp"

#include <exception>
#include <vector>

#include <Teuchos_DefaultMpiComm.hpp>
#include <Teuchos_ParameterList.hpp>
#include <Tpetra_Core.hpp>
#include <Zoltan2_BasicVectorAdapter.hpp>
#include <Zoltan2_PartitioningProblem.hpp>
#include <Zoltan2_PartitioningSolution.hpp>

namespace rcb::bench {
namespace {

using Adapter = Zoltan2::BasicVectorAdapter<Zoltan2::BasicUserTypes<double, int, long long>>;
using PartitioningProblem = Zoltan2::PartitioningProblem<Adapter>;

template <typename Action>
std::string guarded(const Action& action) {
  try {
    action();
    return {};
  } catch (const std::exception& error) {
    const std::string what = error.what();
    return what.empty() ? "an exception without words" : what;
  }
}

}  // namespace

struct MultiJagged::State {
  std::vector<long long> ids;
  Teuchos::ParameterList parameters{"rcb_bench"};
  std::unique_ptr<Adapter> adapter;
  std::unique_ptr<PartitioningProblem> problem;
};

MultiJagged::MultiJagged() = default;
MultiJagged::~MultiJagged() = default;

std::string MultiJagged::prepare(int dims, std::size_t count, const std::array<const double*, 3>& position,
                                 const std::int64_t* id, int parts, bool keep_boxes) {
  return guarded([&] {
    state_ = std::make_unique<State>();
    state_->ids.assign(id, id + count);
    std::vector<const double*> axes(position.begin(), position.begin() + dims);
    std::vector<int> strides(axes.size(), 1);
    std::vector<const double*> no_weights;
    std::vector<int> no_strides;
    state_->adapter =
        std::make_unique<Adapter>(static_cast<int>(count), state_->ids.data(), axes, strides, no_weights, no_strides);
    state_->parameters.set("algorithm", "multijagged");
    state_->parameters.set("num_global_parts", parts);
    if (keep_boxes) state_->parameters.set("mj_keep_part_boxes", true);
    const Teuchos::RCP<const Teuchos::Comm<int>> comm = Teuchos::rcp(new Teuchos::MpiComm<int>(MPI_COMM_WORLD));
    state_->problem = std::make_unique<PartitioningProblem>(state_->adapter.get(), &state_->parameters, comm);
  });
}

std::string MultiJagged::solve() {
  return guarded([&] { state_->problem->solve(); });
}

const int* MultiJagged::parts() const { return state_->problem->getSolution().getPartListView(); }

int MultiJagged::owner(int dims, double* point) const {
  int part = -1;
  (void)guarded([&] { part = state_->problem->getSolution().pointAssign(dims, point); });
  return part;
}

void start_zoltan2(int* argc, char*** argv) { Tpetra::initialize(argc, argv); }
void finish_zoltan2() { Tpetra::finalize(); }

}  // namespace rcb::bench
