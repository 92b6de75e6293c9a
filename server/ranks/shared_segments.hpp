// The files through which the processes of a machine share memory: those in which mpirun tells its ranks about the job,
// and, where System V's shared memory is missing or its limits are too low, those of Open MPI's transport vader.
#pragma once

#include "common/base/status.hpp"

namespace rcb::ranks {

// Local. Gives every file whose memory this process shares all of its pages. Open MPI makes them sparse: a page that is
// touched when the file system is full would end the process by SIGBUS, however long it has run. Files of other users,
// and on file systems that can't do this, are left as they are. Errors: io_error, if there is no room.
Status allocate_shared_segments();

}  // namespace rcb::ranks
