! rcbd_mpi.f90: module rcbd_mpi, what the processes of a solver send to each other, over the solver's own MPI: particles that
! are handed over after a step, and the halo. Compile it after rcbd.f90: mpifort rcbd.f90 rcbd_mpi.f90 solver.f90 -lrcbd
!
!   use mpi_f08
!   use rcbd
!   use rcbd_mpi
!   type(rcbd_mpi_moves) :: moves
!   type(rcbd_mpi_halo) :: halo
!   call rcbd_mpi_connect(comm, client)
!   call rcbd_mpi_scene_open(comm, scene, client, 'jet', options)   ! process k of M is seat k of M
!
!   call rcbd_mpi_step(comm, scene, x, step, ids=id)        ! when lists are rebuilt: scene%step() of all processes
!   call moves%make(comm, step, size(id))
!   call moves%move(id)                                     ! allocatable arrays, which get as many rows as there are now
!   call moves%move(x)
!   call scene%cuts(cuts)
!   call cuts%halo(x, near, lists, ids=id, options=rcbd_ask_options(seats=processes))
!   call halo%make(comm, lists, near, size(id))             ! then let arrays have halo%rows + halo%ghosts rows
!
!   call halo%forward_positions(x, v)                       ! at each time step: fills in the ghosts' rows
!   call halo%reverse_add(force)
!
! client/examples/fortran/dem.f90 is a whole solver. rcbd/mpi.h has the same in C, and does the same to the bit.
!
! Arrays are of int32, int64, real32 or real64, and of rank 1, (rows), or 2, (columns, rows).
!
! Failures are told as in module rcbd. Procedures that take a communicator are called by all its processes and fail for all
! of them if they do for one, with that one's code and text; without stat= process 0 prints it. What else fails on one
! process the solver lets all know by rcbd_mpi_agree(), since nobody may wait for one that has given up. rcbd_mpi_step()
! closes the scene of the process whose step failed. move, forward and reverse_add fail on one process alone, where they are
! called wrongly or another process sends other arrays: end with MPI_Abort then, or leave stat= out.
!
! Order. The rows of each process stay in their order. Those that come from others follow, by process, and by row where they
! come from. Ghosts are ordered alike, one's own periodic images in one's own place. reverse_add adds in this order, so its
! sums are the same each time; those of integers don't depend on the number of processes either, and wrap around.
!
! What MPI returns is not looked at: communicators need the error handler that they have, MPI_ERRORS_ARE_FATAL.
!
! Messages go over the communicator that is given, with the tag 7470, and only between processes that have rows for each
! other. Where the solver receives with MPI_ANY_TAG meanwhile, give a duplicate (MPI_Comm_dup). Plans are good until the next
! step, and have nothing of MPI's that is to be freed.

module rcbd_mpi
  use, intrinsic :: iso_c_binding, only: c_f_pointer, c_int, c_loc, c_ptr
  use, intrinsic :: iso_fortran_env, only: error_unit, int32, int64, real32, real64
  use mpi_f08
  use rcbd
  use rcbd_c, only: c_exit
  implicit none
  private
  public :: rcbd_mpi_agree, rcbd_mpi_connect, rcbd_mpi_scene_open, rcbd_mpi_step

  integer(int32), parameter :: tag = 7470, most = huge(0_int32)  ! rows that MPI can count

  ! Who sends how many entries to whom: those for, and from, process p are offset(p) + 1 to offset(p + 1).
  type :: routes
    type(MPI_Comm) :: comm
    integer(int32) :: rank = 0, size = 0
    integer(int64), allocatable :: out(:), in(:)  ! (0 : size)
    integer(int64), allocatable :: row(:)         ! of the entries that go out
  end type
  ! An array, as words of 32 bits; MPI is told what they are.
  type :: lane
    integer(int32), pointer :: word(:, :) => null()  ! (words of a row, rows)
    type(MPI_Datatype) :: element
    integer(int32) :: columns = 0
  end type

  interface as_lane
    module procedure lane_i4_1, lane_i4_2, lane_i8_1, lane_i8_2, &
      lane_r4_1, lane_r4_2, lane_r8_1, lane_r8_2
  end interface
  interface rcbd_mpi_step
    module procedure step_r8, step_r4, step_axes_r8, step_axes_r4
  end interface
  interface shift_ghosts
    module procedure shift_r8, shift_r4
  end interface

  type, public :: rcbd_mpi_moves
    integer(int64) :: before = 0, rows = 0  ! of this process, before the moves and after them
    type(routes), private :: way
    integer(int64), allocatable, private :: stays(:)
  contains
    procedure :: make => make_moves
    procedure, private :: move_i4_1, move_i4_2, move_i8_1, move_i8_2, &
      move_r4_1, move_r4_2, move_r8_1, move_r8_2
    generic :: move => move_i4_1, move_i4_2, move_i8_1, move_i8_2, &
      move_r4_1, move_r4_2, move_r8_1, move_r8_2
  end type
  type, public :: rcbd_mpi_halo
    integer(int64) :: rows = 0    ! of this process
    integer(int64) :: ghosts = 0  ! copies of other processes' rows, and of periodic images: the rows after these
    type(routes), private :: way
    real(real64), allocatable, private :: shift(:, :)  ! (dims, ghosts): what is to be added to positions
  contains
    procedure :: make => make_halo
    procedure, private :: forward_i4_1, forward_i4_2, forward_i8_1, forward_i8_2, &
      forward_r4_1, forward_r4_2, forward_r8_1, forward_r8_2
    generic :: forward => forward_i4_1, forward_i4_2, forward_i8_1, forward_i8_2, &
      forward_r4_1, forward_r4_2, forward_r8_1, forward_r8_2
    procedure, private :: positions_r8, positions_r4, positions_axes_r8, positions_axes_r4
    generic :: forward_positions => positions_r8, positions_r4, positions_axes_r8, positions_axes_r4
    procedure, private :: add_i4_1, add_i4_2, add_i8_1, add_i8_2, &
      add_r4_1, add_r4_2, add_r8_1, add_r8_2
    generic :: reverse_add => add_i4_1, add_i4_2, add_i8_1, add_i8_2, &
      add_r4_1, add_r4_2, add_r8_1, add_r8_2
  end type

contains

  ! ---- failures ----

  ! Of all processes: stat is rcbd_ok where all have that one. Otherwise all get stat and errmsg of the first process that
  ! has not; rcbd_aborted and rcbd_deadline_exceeded, which may follow from what failed on another one, come after all others.
  subroutine rcbd_mpi_agree(comm, stat, errmsg)
    type(MPI_Comm), intent(in) :: comm
    integer, intent(inout) :: stat
    character(*), intent(inout) :: errmsg
    integer(int32) :: rank, size, mine, first, code
    character(1024) :: text
    call MPI_Comm_rank(comm, rank)
    call MPI_Comm_size(comm, size)
    mine = rank
    if (stat == rcbd_aborted .or. stat == rcbd_deadline_exceeded) mine = size + rank
    if (stat == rcbd_ok) mine = 2 * size
    call MPI_Allreduce(mine, first, 1_int32, MPI_INTEGER4, MPI_MIN, comm)
    if (first == 2 * size) return
    first = mod(first, size)
    code = int(stat, int32)
    text = errmsg
    if (first == rank .and. index(errmsg, 'process ') /= 1) &  ! else it was agreed on before
      write (text, '(a, i0, 2a)') 'process ', rank, ': ', errmsg(:min(len_trim(errmsg), 1000))
    call MPI_Bcast(code, 1_int32, MPI_INTEGER4, first, comm)
    call MPI_Bcast(text, 1024_int32, MPI_CHARACTER, first, comm)
    stat = code
    errmsg = text
  end subroutine

  ! Of all processes, which agree: whether this has failed; tells it then.
  logical function failed(comm, code, why, stat, errmsg)
    type(MPI_Comm), intent(in) :: comm
    integer, intent(in) :: code
    character(*), intent(in) :: why
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    integer(int32) :: rank
    failed = code /= rcbd_ok
    if (present(stat)) stat = code
    if (.not. failed) return
    if (present(errmsg)) errmsg = why
    if (present(stat)) return
    call MPI_Comm_rank(comm, rank)
    if (rank == 0) write (error_unit, '(3a)') rcbd_code_name(code), ': ', trim(why)
    flush (error_unit)
    call MPI_Barrier(comm)  ! an mpirun ends all processes when it sees that one has ended
    call c_exit(1_c_int)
  end function

  ! Whether a plan isn't made, or an array hasn't the rows that it should have; tells it then.
  logical function wrong(way, has, should, stat, errmsg)
    type(routes), intent(in) :: way
    integer(int64), intent(in) :: has, should
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    character(128) :: message
    wrong = has /= should .or. .not. allocated(way%out)
    if (present(stat)) stat = rcbd_ok
    if (.not. wrong) return
    message = 'the plan isn''t made: call make() first'
    if (allocated(way%out)) write (message, '(2(a, i0))') 'an array has rows: ', has, '; there should be ', should
    call rcbd_failed(rcbd_invalid_argument, trim(message), stat, errmsg)
  end function

  ! ---- client and scene ----

  ! Of all processes: client%connect().
  subroutine rcbd_mpi_connect(comm, client, endpoint, options, stat, errmsg)
    type(MPI_Comm), intent(in) :: comm
    class(rcbd_client), intent(inout) :: client
    character(*), intent(in), optional :: endpoint
    type(rcbd_connect_options), intent(in), optional :: options
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    integer :: code
    character(1024) :: why
    call client%connect(endpoint, options, code, why)
    call rcbd_mpi_agree(comm, code, why)
    if (failed(comm, code, why, stat, errmsg)) call client%release()
  end subroutine

  ! Of all processes: scene%open() with seat and seats from the communicator, the others after process 0, so that `replace`
  ! needs no more care. A scene has at most 1,024 seats.
  subroutine rcbd_mpi_scene_open(comm, scene, client, name, options, stat, errmsg)
    type(MPI_Comm), intent(in) :: comm
    class(rcbd_scene), intent(inout) :: scene
    class(rcbd_client), intent(in) :: client
    character(*), intent(in) :: name
    type(rcbd_scene_options), intent(in), optional :: options
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(rcbd_scene_options) :: mine
    integer :: code, turn
    character(1024) :: why
    if (present(options)) mine = options
    call MPI_Comm_rank(comm, mine%seat)
    call MPI_Comm_size(comm, mine%seats)
    code = rcbd_ok
    do turn = 0, 1
      if (merge(0, 1, mine%seat == 0) == turn) call scene%open(client, name, mine, code, why)
      call rcbd_mpi_agree(comm, code, why)
      if (code /= rcbd_ok) call scene%release()
      if (code /= rcbd_ok) exit
    end do
    if (failed(comm, code, why, stat, errmsg)) return
  end subroutine

  ! ---- steps ----

  ! Of all processes, after scene%step(): where it failed on one, that one closes its scene, which ends the step of the others.
  ! One that comes to its step after that waits for its deadline.
  subroutine end_step(comm, scene, code, why, stat, errmsg)
    type(MPI_Comm), intent(in) :: comm
    class(rcbd_scene), intent(in) :: scene
    integer, intent(inout) :: code
    character(*), intent(inout) :: why
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    integer :: ignored
    if (code /= rcbd_ok) call scene%close(ignored)
    call rcbd_mpi_agree(comm, code, why)
    if (failed(comm, code, why, stat, errmsg)) return
  end subroutine

  subroutine step_r8(comm, scene, x, result, ids, ids4, weights, options, stat, errmsg)
    type(MPI_Comm), intent(in) :: comm
    class(rcbd_scene), intent(in) :: scene
    real(real64), intent(in), target :: x(:, :)
    type(rcbd_step), intent(inout), optional :: result
    integer(int64), intent(in), target, optional :: ids(:)
    integer(int32), intent(in), optional :: ids4(:)
    real(real64), intent(in), target, optional :: weights(:)
    type(rcbd_step_options), intent(in), optional :: options
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    integer :: code
    character(1024) :: why
    call scene%step(x, result, ids, ids4, weights, options, code, why)
    call end_step(comm, scene, code, why, stat, errmsg)
  end subroutine

  subroutine step_axes_r8(comm, scene, x, y, z, result, ids, ids4, weights, options, stat, errmsg)
    type(MPI_Comm), intent(in) :: comm
    class(rcbd_scene), intent(in) :: scene
    real(real64), intent(in), target :: x(:)
    real(real64), intent(in), target, optional :: y(:), z(:)
    type(rcbd_step), intent(inout), optional :: result
    integer(int64), intent(in), target, optional :: ids(:)
    integer(int32), intent(in), optional :: ids4(:)
    real(real64), intent(in), target, optional :: weights(:)
    type(rcbd_step_options), intent(in), optional :: options
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    integer :: code
    character(1024) :: why
    call scene%step(x, y, z, result, ids, ids4, weights, options, code, why)
    call end_step(comm, scene, code, why, stat, errmsg)
  end subroutine

  subroutine step_r4(comm, scene, x, result, ids, ids4, weights, options, stat, errmsg)
    type(MPI_Comm), intent(in) :: comm
    class(rcbd_scene), intent(in) :: scene
    real(real32), intent(in), target :: x(:, :)
    type(rcbd_step), intent(inout), optional :: result
    integer(int64), intent(in), target, optional :: ids(:)
    integer(int32), intent(in), optional :: ids4(:)
    real(real64), intent(in), target, optional :: weights(:)
    type(rcbd_step_options), intent(in), optional :: options
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    integer :: code
    character(1024) :: why
    call scene%step(x, result, ids, ids4, weights, options, code, why)
    call end_step(comm, scene, code, why, stat, errmsg)
  end subroutine

  subroutine step_axes_r4(comm, scene, x, y, z, result, ids, ids4, weights, options, stat, errmsg)
    type(MPI_Comm), intent(in) :: comm
    class(rcbd_scene), intent(in) :: scene
    real(real32), intent(in), target :: x(:)
    real(real32), intent(in), target, optional :: y(:), z(:)
    type(rcbd_step), intent(inout), optional :: result
    integer(int64), intent(in), target, optional :: ids(:)
    integer(int32), intent(in), optional :: ids4(:)
    real(real64), intent(in), target, optional :: weights(:)
    type(rcbd_step_options), intent(in), optional :: options
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    integer :: code
    character(1024) :: why
    call scene%step(x, y, z, result, ids, ids4, weights, options, code, why)
    call end_step(comm, scene, code, why, stat, errmsg)
  end subroutine

  ! ---- routes ----

  ! From so many entries for each process: tells their numbers, and gives `out` and `in`. A failure until here is told, too.
  logical function no_way(way, comm, number, code, why, stat, errmsg)
    type(routes), intent(inout) :: way
    type(MPI_Comm), intent(in) :: comm
    integer(int64), intent(in) :: number(0:)
    integer, intent(inout) :: code
    character(*), intent(inout) :: why
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    integer(int64), allocatable :: coming(:)
    integer(int32) :: p
    if (allocated(way%out)) deallocate (way%out, way%in)
    if (code == rcbd_ok .and. any(number > most)) then
      code = rcbd_too_large
      why = 'more rows for one process than MPI can count; use more processes'
    end if
    call rcbd_mpi_agree(comm, code, why)
    no_way = failed(comm, code, why, stat, errmsg)
    if (no_way) return
    allocate (coming(0:way%size - 1))
    call MPI_Alltoall(number, 1_int32, MPI_INTEGER8, coming, 1_int32, MPI_INTEGER8, comm)
    way%comm = comm
    allocate (way%out(0:way%size), way%in(0:way%size))
    way%out(0) = 0
    way%in(0) = 0
    do p = 1, way%size
      way%out(p) = way%out(p - 1) + number(p - 1)
      way%in(p) = way%in(p - 1) + coming(p - 1)
    end do
  end function

  function lane_of(at, words, columns, rows, element) result(one)
    type(c_ptr), intent(in) :: at
    integer, intent(in) :: words, columns
    integer(int64), intent(in) :: rows
    type(MPI_Datatype), intent(in) :: element
    type(lane) :: one
    call c_f_pointer(at, one%word, [int(words, int64) * columns, rows])
    one%element = element
    one%columns = int(columns, int32)
  end function

  function lane_i4_1(a) result(one)
    integer(int32), contiguous, target, intent(in) :: a(:)
    type(lane) :: one
    one = lane_of(c_loc(a), 1, 1, size(a, kind=int64), MPI_INTEGER4)
  end function

  function lane_i4_2(a) result(one)
    integer(int32), contiguous, target, intent(in) :: a(:, :)
    type(lane) :: one
    one = lane_of(c_loc(a), 1, size(a, 1), size(a, 2, kind=int64), MPI_INTEGER4)
  end function

  function lane_i8_1(a) result(one)
    integer(int64), contiguous, target, intent(in) :: a(:)
    type(lane) :: one
    one = lane_of(c_loc(a), 2, 1, size(a, kind=int64), MPI_INTEGER8)
  end function

  function lane_i8_2(a) result(one)
    integer(int64), contiguous, target, intent(in) :: a(:, :)
    type(lane) :: one
    one = lane_of(c_loc(a), 2, size(a, 1), size(a, 2, kind=int64), MPI_INTEGER8)
  end function

  function lane_r4_1(a) result(one)
    real(real32), contiguous, target, intent(in) :: a(:)
    type(lane) :: one
    one = lane_of(c_loc(a), 1, 1, size(a, kind=int64), MPI_REAL4)
  end function

  function lane_r4_2(a) result(one)
    real(real32), contiguous, target, intent(in) :: a(:, :)
    type(lane) :: one
    one = lane_of(c_loc(a), 1, size(a, 1), size(a, 2, kind=int64), MPI_REAL4)
  end function

  function lane_r8_1(a) result(one)
    real(real64), contiguous, target, intent(in) :: a(:)
    type(lane) :: one
    one = lane_of(c_loc(a), 2, 1, size(a, kind=int64), MPI_REAL8)
  end function

  function lane_r8_2(a) result(one)
    real(real64), contiguous, target, intent(in) :: a(:, :)
    type(lane) :: one
    one = lane_of(c_loc(a), 2, size(a, 1), size(a, 2, kind=int64), MPI_REAL8)
  end function
  ! Sends entries, in one message for each process that there are some for. `from`, `to`: the numbers that go and come, as
  ! offsets. Entry e is row(e) of the lanes `of`, and comes to be the row first + e of the lanes `into`.
  logical function exchanged(way, from, to, row, of, into, first, stat, errmsg)
    type(routes), intent(in) :: way
    integer(int64), intent(in) :: from(0:), to(0:), row(:), first
    type(lane), intent(in) :: of(:), into(:)
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    integer(int32), allocatable, asynchronous :: sent(:), got(:)
    integer(int64), allocatable :: sent_at(:), got_at(:)
    type(MPI_Request), allocatable :: request(:)
    type(MPI_Datatype), allocatable :: types(:)
    type(MPI_Status), allocatable :: status(:)
    integer(MPI_COUNT_KIND) :: elements
    character(128) :: message
    integer(int32) :: p, used, receives
    integer(int64) :: e
    call place(of, from, sent_at)
    call place(of, to, got_at)
    allocate (sent(sent_at(way%size)), got(got_at(way%size)), request(2 * way%size), &
              types(2 * way%size), status(2 * way%size))
    used = 0
    do p = 0, way%size - 1
      if (p == way%rank .or. to(p + 1) == to(p)) cycle
      used = used + 1
      types(used) = rows_type(of, got_at(p), to(p + 1) - to(p))
      call MPI_Irecv(got, 1_int32, types(used), p, tag, way%comm, request(used))
    end do
    receives = used
    do p = 0, way%size - 1
      call pack_rows(of, row(from(p) + 1:from(p + 1)), sent(sent_at(p) + 1:sent_at(p + 1)))
      if (p == way%rank .or. from(p + 1) == from(p)) cycle
      used = used + 1
      types(used) = rows_type(of, sent_at(p), from(p + 1) - from(p))
      call MPI_Isend(sent, 1_int32, types(used), p, tag, way%comm, request(used))
    end do
    p = way%rank
    do e = 1, sent_at(p + 1) - sent_at(p)
      got(got_at(p) + e) = sent(sent_at(p) + e)
    end do
    call MPI_Waitall(used, request, status)
    exchanged = .true.
    do p = 1, used
      if (p <= receives) then
        call MPI_Get_elements_x(status(p), types(p), elements)
        associate (s => status(p)%MPI_SOURCE)
          if (elements /= (to(s + 1) - to(s)) * sum(int(of%columns, int64))) then
            exchanged = .false.
            write (message, '(a, i0, a)') 'process ', s, ' has sent other arrays than are given here'
          end if
        end associate
      end if
      call MPI_Type_free(types(p))
    end do
    if (.not. exchanged) call rcbd_failed(rcbd_invalid_argument, trim(message) // &
      '; give the same ones in the same order on all processes', stat, errmsg)
    if (.not. exchanged) return
    do p = 0, way%size - 1
      call unpack_rows(into, first + to(p), to(p + 1) - to(p), got(got_at(p) + 1:got_at(p + 1)))
    end do
  end function

  ! Words of so many rows; each lane begins where any type may.
  pure integer(int64) function words_of(one, rows)
    type(lane), intent(in) :: one
    integer(int64), intent(in) :: rows
    words_of = (size(one%word, 1) * rows + 1) / 2 * 2
  end function

  ! Where in a buffer the lanes for each process begin.
  subroutine place(lanes, entries, at)
    type(lane), intent(in) :: lanes(:)
    integer(int64), intent(in) :: entries(0:)
    integer(int64), allocatable, intent(out) :: at(:)
    integer :: p, k
    allocate (at(0:size(entries) - 1))
    at(0) = 0
    do p = 1, size(entries) - 1
      at(p) = at(p - 1)
      do k = 1, size(lanes)
        at(p) = at(p) + words_of(lanes(k), entries(p) - entries(p - 1))
      end do
    end do
  end subroutine

  ! The rows of all lanes, after so many words of a buffer.
  function rows_type(lanes, skipped, rows) result(together)
    type(lane), intent(in) :: lanes(:)
    integer(int64), intent(in) :: skipped, rows
    type(MPI_Datatype) :: together
    type(MPI_Datatype) :: row(size(lanes))
    integer(int32) :: number(size(lanes)), k
    integer(MPI_ADDRESS_KIND) :: at(size(lanes)), next
    next = 4 * skipped
    do k = 1, size(lanes, kind=int32)
      call MPI_Type_contiguous(lanes(k)%columns, lanes(k)%element, row(k))
      number(k) = int(rows, int32)
      at(k) = next
      next = next + 4 * words_of(lanes(k), rows)
    end do
    call MPI_Type_create_struct(size(lanes, kind=int32), number, at, row, together)
    call MPI_Type_commit(together)
    do k = 1, size(lanes, kind=int32)
      call MPI_Type_free(row(k))
    end do
  end function

  subroutine pack_rows(lanes, row, buffer)
    type(lane), intent(in) :: lanes(:)
    integer(int64), intent(in) :: row(:)
    integer(int32), contiguous, intent(inout) :: buffer(:)
    integer(int64) :: e, at
    integer :: k, words
    at = 0
    do k = 1, size(lanes)
      words = size(lanes(k)%word, 1)
      do e = 1, size(row, kind=int64)
        buffer(at + (e - 1) * words + 1:at + e * words) = lanes(k)%word(:, row(e))
      end do
      at = at + words_of(lanes(k), size(row, kind=int64))
    end do
  end subroutine

  subroutine unpack_rows(lanes, first, rows, buffer)
    type(lane), intent(in) :: lanes(:)
    integer(int64), intent(in) :: first, rows
    integer(int32), contiguous, intent(in) :: buffer(:)
    integer(int64) :: e, at
    integer :: k, words
    at = 0
    do k = 1, size(lanes)
      words = size(lanes(k)%word, 1)
      do e = 1, rows
        lanes(k)%word(:, first + e) = buffer(at + (e - 1) * words + 1:at + e * words)
      end do
      at = at + words_of(lanes(k), rows)
    end do
  end subroutine

  ! ---- handing over ----

  ! Of all processes, after a step with so many rows: which go where, and how many come.
  subroutine make_moves(self, comm, step, rows, stat, errmsg)
    class(rcbd_mpi_moves), intent(inout) :: self
    type(MPI_Comm), intent(in) :: comm
    type(rcbd_step), intent(in) :: step
    integer, intent(in) :: rows
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    integer(int64), allocatable :: number(:)
    integer :: code
    character(1024) :: why
    call MPI_Comm_rank(comm, self%way%rank)
    call MPI_Comm_size(comm, self%way%size)
    allocate (number(0:self%way%size - 1))
    number = 0
    call sort_out(self, step, int(rows, int64), number, code, why)
    if (no_way(self%way, comm, number, code, why, stat, errmsg)) return
    self%before = rows
    self%rows = size(self%stays, kind=int64) + self%way%in(self%way%size)
  end subroutine

  ! The rows that go, by process, and those that stay.
  subroutine sort_out(self, step, rows, number, code, why)
    class(rcbd_mpi_moves), intent(inout) :: self
    type(rcbd_step), intent(in) :: step
    integer(int64), intent(in) :: rows
    integer(int64), intent(inout) :: number(0:)
    integer, intent(out) :: code
    character(*), intent(out) :: why
    integer(int64), allocatable :: next(:)
    integer(int64) :: k, row, left
    integer(int32) :: p
    code = rcbd_invalid_argument
    why = 'the step wasn''t made here: it names no rows'
    if (.not. allocated(step%leaving_row)) return
    why = 'rows leave that aren''t there, or for seats that no process has; give the rows of the step, and open the ' // &
      'scene with this communicator'
    if (any(step%leaving_row > rows) .or. any(step%leaving_seat >= self%way%size)) return
    if (rows < size(step%leaving_row, kind=int64)) return
    code = rcbd_ok
    do k = 1, size(step%leaving_seat, kind=int64)
      number(step%leaving_seat(k)) = number(step%leaving_seat(k)) + 1
    end do
    allocate (next(0:self%way%size))
    next(0) = 0
    do p = 1, self%way%size
      next(p) = next(p - 1) + number(p - 1)
    end do
    if (allocated(self%stays)) deallocate (self%stays, self%way%row)
    allocate (self%stays(rows - size(step%leaving_row, kind=int64)), self%way%row(size(step%leaving_row, kind=int64)))
    left = 0
    do row = 1, rows
      if (left < size(step%leaving_row, kind=int64)) then
        if (step%leaving_row(left + 1) == row) then
          left = left + 1
          p = step%leaving_seat(left)
          next(p) = next(p) + 1
          self%way%row(next(p)) = row
          cycle
        end if
      end if
      self%stays(row - left) = row
    end do
  end subroutine

  ! The rows of an array that stay, and those that come, in the larger or smaller one that takes its place.
  logical function moved_rows(self, of, into, stat, errmsg)
    class(rcbd_mpi_moves), intent(in) :: self
    type(lane), intent(in) :: of, into
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    integer(int64) :: k
    do k = 1, size(self%stays, kind=int64)
      into%word(:, k) = of%word(:, self%stays(k))
    end do
    moved_rows = exchanged(self%way, self%way%out, self%way%in, self%way%row, [of], [into], size(self%stays, kind=int64), &
                           stat, errmsg)
  end function

  subroutine move_i4_1(self, a, stat, errmsg)
    class(rcbd_mpi_moves), intent(in) :: self
    integer(int32), allocatable, target, intent(inout) :: a(:)
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    integer(int32), allocatable, target :: moved(:)
    if (wrong(self%way, size(a, kind=int64), self%before, stat, errmsg)) return
    allocate (moved(self%rows))
    if (.not. moved_rows(self, as_lane(a), as_lane(moved), stat, errmsg)) return
    call move_alloc(moved, a)
  end subroutine

  subroutine move_i4_2(self, a, stat, errmsg)
    class(rcbd_mpi_moves), intent(in) :: self
    integer(int32), allocatable, target, intent(inout) :: a(:, :)
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    integer(int32), allocatable, target :: moved(:, :)
    if (wrong(self%way, size(a, 2, kind=int64), self%before, stat, errmsg)) return
    allocate (moved(size(a, 1), self%rows))
    if (.not. moved_rows(self, as_lane(a), as_lane(moved), stat, errmsg)) return
    call move_alloc(moved, a)
  end subroutine

  subroutine move_i8_1(self, a, stat, errmsg)
    class(rcbd_mpi_moves), intent(in) :: self
    integer(int64), allocatable, target, intent(inout) :: a(:)
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    integer(int64), allocatable, target :: moved(:)
    if (wrong(self%way, size(a, kind=int64), self%before, stat, errmsg)) return
    allocate (moved(self%rows))
    if (.not. moved_rows(self, as_lane(a), as_lane(moved), stat, errmsg)) return
    call move_alloc(moved, a)
  end subroutine

  subroutine move_i8_2(self, a, stat, errmsg)
    class(rcbd_mpi_moves), intent(in) :: self
    integer(int64), allocatable, target, intent(inout) :: a(:, :)
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    integer(int64), allocatable, target :: moved(:, :)
    if (wrong(self%way, size(a, 2, kind=int64), self%before, stat, errmsg)) return
    allocate (moved(size(a, 1), self%rows))
    if (.not. moved_rows(self, as_lane(a), as_lane(moved), stat, errmsg)) return
    call move_alloc(moved, a)
  end subroutine

  subroutine move_r4_1(self, a, stat, errmsg)
    class(rcbd_mpi_moves), intent(in) :: self
    real(real32), allocatable, target, intent(inout) :: a(:)
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    real(real32), allocatable, target :: moved(:)
    if (wrong(self%way, size(a, kind=int64), self%before, stat, errmsg)) return
    allocate (moved(self%rows))
    if (.not. moved_rows(self, as_lane(a), as_lane(moved), stat, errmsg)) return
    call move_alloc(moved, a)
  end subroutine

  subroutine move_r4_2(self, a, stat, errmsg)
    class(rcbd_mpi_moves), intent(in) :: self
    real(real32), allocatable, target, intent(inout) :: a(:, :)
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    real(real32), allocatable, target :: moved(:, :)
    if (wrong(self%way, size(a, 2, kind=int64), self%before, stat, errmsg)) return
    allocate (moved(size(a, 1), self%rows))
    if (.not. moved_rows(self, as_lane(a), as_lane(moved), stat, errmsg)) return
    call move_alloc(moved, a)
  end subroutine

  subroutine move_r8_1(self, a, stat, errmsg)
    class(rcbd_mpi_moves), intent(in) :: self
    real(real64), allocatable, target, intent(inout) :: a(:)
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    real(real64), allocatable, target :: moved(:)
    if (wrong(self%way, size(a, kind=int64), self%before, stat, errmsg)) return
    allocate (moved(self%rows))
    if (.not. moved_rows(self, as_lane(a), as_lane(moved), stat, errmsg)) return
    call move_alloc(moved, a)
  end subroutine

  subroutine move_r8_2(self, a, stat, errmsg)
    class(rcbd_mpi_moves), intent(in) :: self
    real(real64), allocatable, target, intent(inout) :: a(:, :)
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    real(real64), allocatable, target :: moved(:, :)
    if (wrong(self%way, size(a, 2, kind=int64), self%before, stat, errmsg)) return
    allocate (moved(size(a, 1), self%rows))
    if (.not. moved_rows(self, as_lane(a), as_lane(moved), stat, errmsg)) return
    call move_alloc(moved, a)
  end subroutine

  ! ---- halo ----

  ! Of all processes, when lists are rebuilt: how many ghosts come. `lists` is what cuts%halo() gave for as many seats as there
  ! are processes, of so many rows, with `near`.
  subroutine make_halo(self, comm, lists, near, rows, stat, errmsg)
    class(rcbd_mpi_halo), intent(inout), target :: self
    type(MPI_Comm), intent(in) :: comm
    type(rcbd_halo), intent(in) :: lists
    type(rcbd_near), intent(in) :: near
    integer, intent(in) :: rows
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    integer(int64), allocatable :: number(:)
    integer :: code
    character(1024) :: why
    call MPI_Comm_rank(comm, self%way%rank)
    call MPI_Comm_size(comm, self%way%size)
    allocate (number(0:self%way%size - 1))
    number = 0
    call check_lists(lists, near, self%way, int(rows, int64), code, why)
    if (code == rcbd_ok) number(:) = lists%offset(1:) - lists%offset(:self%way%size - 1)
    if (no_way(self%way, comm, number, code, why, stat, errmsg)) return
    self%rows = rows
    self%ghosts = self%way%in(self%way%size)
    if (allocated(self%way%row)) deallocate (self%way%row)
    allocate (self%way%row(size(lists%row, kind=int64)))
    self%way%row(:) = lists%row
    call tell_shifts(self, lists, near, stat, errmsg)
  end subroutine

  ! Whether a plan can be made of these lists on this process: of all rows, which are its own, with the distance they are for.
  subroutine check_lists(lists, near, way, rows, code, why)
    type(rcbd_halo), intent(in) :: lists
    type(rcbd_near), intent(in) :: near
    type(routes), intent(in) :: way
    integer(int64), intent(in) :: rows
    integer, intent(out) :: code
    character(*), intent(out) :: why
    logical :: fits
    code = rcbd_invalid_argument
    why = 'the halo''s lists aren''t for as many seats as there are processes, or of other rows; give cuts%halo() the option ' // &
      'seats and the rows that are here now'
    if (.not. (allocated(lists%offset) .and. allocated(lists%of_seat))) return
    if (size(lists%of_seat) /= way%size .or. sum(lists%of_seat) /= rows) return
    if (lists%of_seat(way%rank) /= rows) then
      write (why, '(2(i0, a))') rows - lists%of_seat(way%rank), ' of ', rows, ' rows belong to other processes; hand them ' // &
        'over after the step (rcbd_mpi_moves), and give cuts%halo() the ids of the step'
      return
    end if
    fits = .not. any(lists%shift /= 0)
    if (.not. fits .and. allocated(near%lo) .and. allocated(near%hi)) &
      fits = size(near%lo) == size(lists%shift, 1) .and. size(near%hi) == size(lists%shift, 1)
    why = 'the halo''s lists have shifts, and `near` has no periodic box; give the one that cuts%halo() was given'
    if (fits) code = rcbd_ok
  end subroutine

  ! Tells those that get entries by how much each is shifted.
  subroutine tell_shifts(self, lists, near, stat, errmsg)
    class(rcbd_mpi_halo), intent(inout), target :: self
    type(rcbd_halo), intent(in) :: lists
    type(rcbd_near), intent(in) :: near
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    real(real64), allocatable, target :: mine(:, :)
    integer(int64), allocatable :: entry(:)
    integer(int64) :: k
    integer :: dims, a
    dims = size(lists%shift, 1)
    if (allocated(self%shift)) deallocate (self%shift)
    allocate (self%shift(dims, self%ghosts), mine(dims, size(lists%row, kind=int64)), entry(size(lists%row, kind=int64)))
    mine = 0
    do k = 1, size(entry, kind=int64)
      entry(k) = k
      do a = 1, dims
        if (lists%shift(a, k) /= 0) mine(a, k) = lists%shift(a, k) * (near%hi(a) - near%lo(a))
      end do
    end do
    if (.not. exchanged(self%way, self%way%out, self%way%in, entry, [as_lane(mine)], [as_lane(self%shift)], 0_int64, &
                        stat, errmsg)) return
  end subroutine

  subroutine append(lanes, used, one)
    type(lane), intent(inout) :: lanes(:)
    integer, intent(inout) :: used
    type(lane), intent(in) :: one
    used = used + 1
    lanes(used) = one
  end subroutine

  logical function wrong_dims(self, dims, stat, errmsg)
    class(rcbd_mpi_halo), intent(in) :: self
    integer, intent(in) :: dims
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    wrong_dims = .true.
    if (allocated(self%shift)) wrong_dims = size(self%shift, 1) /= dims
    if (wrong_dims) call rcbd_failed(rcbd_invalid_argument, 'positions of other dims than the halo''s cuts', stat, errmsg)
  end function

  ! Fills in the ghosts' rows; says whether it could.
  logical function filled(self, lanes, stat, errmsg)
    class(rcbd_mpi_halo), intent(in) :: self
    type(lane), intent(in) :: lanes(:)
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    integer :: k
    filled = .false.
    do k = 1, size(lanes)
      if (wrong(self%way, size(lanes(k)%word, 2, kind=int64), self%rows + self%ghosts, stat, errmsg)) return
    end do
    filled = exchanged(self%way, self%way%out, self%way%in, self%way%row, lanes, lanes, self%rows, stat, errmsg)
  end function

  ! The ghosts' rows of an array, at those that they are of: entry e is of row self%way%row(e).
  logical function brought_home(self, of, into, stat, errmsg)
    class(rcbd_mpi_halo), intent(in) :: self
    type(lane), intent(in) :: of, into
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    integer(int64), allocatable :: ghost(:)
    integer(int64) :: k
    allocate (ghost(self%ghosts))
    do k = 1, self%ghosts
      ghost(k) = self%rows + k
    end do
    brought_home = exchanged(self%way, self%way%in, self%way%out, ghost, [of], [into], 0_int64, stat, errmsg)
  end function

  subroutine forward_i4_1(self, a, b, c, d, stat, errmsg)
    class(rcbd_mpi_halo), intent(in) :: self
    integer(int32), contiguous, target, intent(inout) :: a(:)
    integer(int32), contiguous, target, intent(inout), optional :: b(:), c(:), d(:)
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(lane) :: lanes(4)
    integer :: used
    used = 0
    call append(lanes, used, as_lane(a))
    if (present(b)) call append(lanes, used, as_lane(b))
    if (present(c)) call append(lanes, used, as_lane(c))
    if (present(d)) call append(lanes, used, as_lane(d))
    if (.not. filled(self, lanes(:used), stat, errmsg)) return
  end subroutine

  subroutine forward_i4_2(self, a, b, c, d, stat, errmsg)
    class(rcbd_mpi_halo), intent(in) :: self
    integer(int32), contiguous, target, intent(inout) :: a(:, :)
    integer(int32), contiguous, target, intent(inout), optional :: b(:, :), c(:, :), d(:, :)
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(lane) :: lanes(4)
    integer :: used
    used = 0
    call append(lanes, used, as_lane(a))
    if (present(b)) call append(lanes, used, as_lane(b))
    if (present(c)) call append(lanes, used, as_lane(c))
    if (present(d)) call append(lanes, used, as_lane(d))
    if (.not. filled(self, lanes(:used), stat, errmsg)) return
  end subroutine

  subroutine forward_i8_1(self, a, b, c, d, stat, errmsg)
    class(rcbd_mpi_halo), intent(in) :: self
    integer(int64), contiguous, target, intent(inout) :: a(:)
    integer(int64), contiguous, target, intent(inout), optional :: b(:), c(:), d(:)
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(lane) :: lanes(4)
    integer :: used
    used = 0
    call append(lanes, used, as_lane(a))
    if (present(b)) call append(lanes, used, as_lane(b))
    if (present(c)) call append(lanes, used, as_lane(c))
    if (present(d)) call append(lanes, used, as_lane(d))
    if (.not. filled(self, lanes(:used), stat, errmsg)) return
  end subroutine

  subroutine forward_i8_2(self, a, b, c, d, stat, errmsg)
    class(rcbd_mpi_halo), intent(in) :: self
    integer(int64), contiguous, target, intent(inout) :: a(:, :)
    integer(int64), contiguous, target, intent(inout), optional :: b(:, :), c(:, :), d(:, :)
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(lane) :: lanes(4)
    integer :: used
    used = 0
    call append(lanes, used, as_lane(a))
    if (present(b)) call append(lanes, used, as_lane(b))
    if (present(c)) call append(lanes, used, as_lane(c))
    if (present(d)) call append(lanes, used, as_lane(d))
    if (.not. filled(self, lanes(:used), stat, errmsg)) return
  end subroutine

  subroutine forward_r4_1(self, a, b, c, d, stat, errmsg)
    class(rcbd_mpi_halo), intent(in) :: self
    real(real32), contiguous, target, intent(inout) :: a(:)
    real(real32), contiguous, target, intent(inout), optional :: b(:), c(:), d(:)
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(lane) :: lanes(4)
    integer :: used
    used = 0
    call append(lanes, used, as_lane(a))
    if (present(b)) call append(lanes, used, as_lane(b))
    if (present(c)) call append(lanes, used, as_lane(c))
    if (present(d)) call append(lanes, used, as_lane(d))
    if (.not. filled(self, lanes(:used), stat, errmsg)) return
  end subroutine

  subroutine forward_r4_2(self, a, b, c, d, stat, errmsg)
    class(rcbd_mpi_halo), intent(in) :: self
    real(real32), contiguous, target, intent(inout) :: a(:, :)
    real(real32), contiguous, target, intent(inout), optional :: b(:, :), c(:, :), d(:, :)
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(lane) :: lanes(4)
    integer :: used
    used = 0
    call append(lanes, used, as_lane(a))
    if (present(b)) call append(lanes, used, as_lane(b))
    if (present(c)) call append(lanes, used, as_lane(c))
    if (present(d)) call append(lanes, used, as_lane(d))
    if (.not. filled(self, lanes(:used), stat, errmsg)) return
  end subroutine

  subroutine forward_r8_1(self, a, b, c, d, stat, errmsg)
    class(rcbd_mpi_halo), intent(in) :: self
    real(real64), contiguous, target, intent(inout) :: a(:)
    real(real64), contiguous, target, intent(inout), optional :: b(:), c(:), d(:)
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(lane) :: lanes(4)
    integer :: used
    used = 0
    call append(lanes, used, as_lane(a))
    if (present(b)) call append(lanes, used, as_lane(b))
    if (present(c)) call append(lanes, used, as_lane(c))
    if (present(d)) call append(lanes, used, as_lane(d))
    if (.not. filled(self, lanes(:used), stat, errmsg)) return
  end subroutine

  subroutine forward_r8_2(self, a, b, c, d, stat, errmsg)
    class(rcbd_mpi_halo), intent(in) :: self
    real(real64), contiguous, target, intent(inout) :: a(:, :)
    real(real64), contiguous, target, intent(inout), optional :: b(:, :), c(:, :), d(:, :)
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(lane) :: lanes(4)
    integer :: used
    used = 0
    call append(lanes, used, as_lane(a))
    if (present(b)) call append(lanes, used, as_lane(b))
    if (present(c)) call append(lanes, used, as_lane(c))
    if (present(d)) call append(lanes, used, as_lane(d))
    if (.not. filled(self, lanes(:used), stat, errmsg)) return
  end subroutine

  ! Moves ghosts to where the images are.
  elemental subroutine shift_r8(x, shift)
    real(real64), intent(inout) :: x
    real(real64), intent(in) :: shift
    if (abs(shift) > 0) x = x + shift
  end subroutine

  subroutine positions_r8(self, x, a, b, c, stat, errmsg)
    class(rcbd_mpi_halo), intent(in) :: self
    real(real64), contiguous, target, intent(inout) :: x(:, :)
    real(real64), contiguous, target, intent(inout), optional :: a(:, :), b(:, :), c(:, :)
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(lane) :: lanes(4)
    integer :: used
    used = 0
    if (wrong_dims(self, size(x, 1), stat, errmsg)) return
    call append(lanes, used, as_lane(x))
    if (present(a)) call append(lanes, used, as_lane(a))
    if (present(b)) call append(lanes, used, as_lane(b))
    if (present(c)) call append(lanes, used, as_lane(c))
    if (.not. filled(self, lanes(:used), stat, errmsg)) return
    call shift_ghosts(x(:, self%rows + 1:), self%shift)
  end subroutine

  subroutine positions_axes_r8(self, x, y, z, stat, errmsg)
    class(rcbd_mpi_halo), intent(in) :: self
    real(real64), contiguous, target, intent(inout) :: x(:)
    real(real64), contiguous, target, intent(inout), optional :: y(:), z(:)
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(lane) :: lanes(3)
    integer :: used
    used = 0
    call append(lanes, used, as_lane(x))
    if (present(y)) call append(lanes, used, as_lane(y))
    if (present(z)) call append(lanes, used, as_lane(z))
    if (wrong_dims(self, used, stat, errmsg)) return
    if (.not. filled(self, lanes(:used), stat, errmsg)) return
    call shift_ghosts(x(self%rows + 1:), self%shift(1, :))
    if (present(y)) call shift_ghosts(y(self%rows + 1:), self%shift(2, :))
    if (present(z)) call shift_ghosts(z(self%rows + 1:), self%shift(3, :))
  end subroutine

  ! Moves ghosts to where the images are.
  elemental subroutine shift_r4(x, shift)
    real(real32), intent(inout) :: x
    real(real64), intent(in) :: shift
    if (abs(shift) > 0) x = real(x + shift, real32)
  end subroutine

  subroutine positions_r4(self, x, a, b, c, stat, errmsg)
    class(rcbd_mpi_halo), intent(in) :: self
    real(real32), contiguous, target, intent(inout) :: x(:, :)
    real(real32), contiguous, target, intent(inout), optional :: a(:, :), b(:, :), c(:, :)
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(lane) :: lanes(4)
    integer :: used
    used = 0
    if (wrong_dims(self, size(x, 1), stat, errmsg)) return
    call append(lanes, used, as_lane(x))
    if (present(a)) call append(lanes, used, as_lane(a))
    if (present(b)) call append(lanes, used, as_lane(b))
    if (present(c)) call append(lanes, used, as_lane(c))
    if (.not. filled(self, lanes(:used), stat, errmsg)) return
    call shift_ghosts(x(:, self%rows + 1:), self%shift)
  end subroutine

  subroutine positions_axes_r4(self, x, y, z, stat, errmsg)
    class(rcbd_mpi_halo), intent(in) :: self
    real(real32), contiguous, target, intent(inout) :: x(:)
    real(real32), contiguous, target, intent(inout), optional :: y(:), z(:)
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(lane) :: lanes(3)
    integer :: used
    used = 0
    call append(lanes, used, as_lane(x))
    if (present(y)) call append(lanes, used, as_lane(y))
    if (present(z)) call append(lanes, used, as_lane(z))
    if (wrong_dims(self, used, stat, errmsg)) return
    if (.not. filled(self, lanes(:used), stat, errmsg)) return
    call shift_ghosts(x(self%rows + 1:), self%shift(1, :))
    if (present(y)) call shift_ghosts(y(self%rows + 1:), self%shift(2, :))
    if (present(z)) call shift_ghosts(z(self%rows + 1:), self%shift(3, :))
  end subroutine

  subroutine add_i4_1(self, a, stat, errmsg)
    class(rcbd_mpi_halo), intent(in) :: self
    integer(int32), contiguous, target, intent(inout) :: a(:)
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    integer(int32), allocatable, target :: home(:)
    integer(int64) :: k
    if (wrong(self%way, size(a, kind=int64), self%rows + self%ghosts, stat, errmsg)) return
    allocate (home(size(self%way%row, kind=int64)))
    if (.not. brought_home(self, as_lane(a), as_lane(home), stat, errmsg)) return
    do k = 1, size(self%way%row, kind=int64)
      a(self%way%row(k)) = a(self%way%row(k)) + home(k)
    end do
  end subroutine

  subroutine add_i4_2(self, a, stat, errmsg)
    class(rcbd_mpi_halo), intent(in) :: self
    integer(int32), contiguous, target, intent(inout) :: a(:, :)
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    integer(int32), allocatable, target :: home(:, :)
    integer(int64) :: k
    if (wrong(self%way, size(a, 2, kind=int64), self%rows + self%ghosts, stat, errmsg)) return
    allocate (home(size(a, 1), size(self%way%row, kind=int64)))
    if (.not. brought_home(self, as_lane(a), as_lane(home), stat, errmsg)) return
    do k = 1, size(self%way%row, kind=int64)
      a(:, self%way%row(k)) = a(:, self%way%row(k)) + home(:, k)
    end do
  end subroutine

  subroutine add_i8_1(self, a, stat, errmsg)
    class(rcbd_mpi_halo), intent(in) :: self
    integer(int64), contiguous, target, intent(inout) :: a(:)
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    integer(int64), allocatable, target :: home(:)
    integer(int64) :: k
    if (wrong(self%way, size(a, kind=int64), self%rows + self%ghosts, stat, errmsg)) return
    allocate (home(size(self%way%row, kind=int64)))
    if (.not. brought_home(self, as_lane(a), as_lane(home), stat, errmsg)) return
    do k = 1, size(self%way%row, kind=int64)
      a(self%way%row(k)) = a(self%way%row(k)) + home(k)
    end do
  end subroutine

  subroutine add_i8_2(self, a, stat, errmsg)
    class(rcbd_mpi_halo), intent(in) :: self
    integer(int64), contiguous, target, intent(inout) :: a(:, :)
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    integer(int64), allocatable, target :: home(:, :)
    integer(int64) :: k
    if (wrong(self%way, size(a, 2, kind=int64), self%rows + self%ghosts, stat, errmsg)) return
    allocate (home(size(a, 1), size(self%way%row, kind=int64)))
    if (.not. brought_home(self, as_lane(a), as_lane(home), stat, errmsg)) return
    do k = 1, size(self%way%row, kind=int64)
      a(:, self%way%row(k)) = a(:, self%way%row(k)) + home(:, k)
    end do
  end subroutine

  subroutine add_r4_1(self, a, stat, errmsg)
    class(rcbd_mpi_halo), intent(in) :: self
    real(real32), contiguous, target, intent(inout) :: a(:)
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    real(real32), allocatable, target :: home(:)
    integer(int64) :: k
    if (wrong(self%way, size(a, kind=int64), self%rows + self%ghosts, stat, errmsg)) return
    allocate (home(size(self%way%row, kind=int64)))
    if (.not. brought_home(self, as_lane(a), as_lane(home), stat, errmsg)) return
    do k = 1, size(self%way%row, kind=int64)
      a(self%way%row(k)) = a(self%way%row(k)) + home(k)
    end do
  end subroutine

  subroutine add_r4_2(self, a, stat, errmsg)
    class(rcbd_mpi_halo), intent(in) :: self
    real(real32), contiguous, target, intent(inout) :: a(:, :)
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    real(real32), allocatable, target :: home(:, :)
    integer(int64) :: k
    if (wrong(self%way, size(a, 2, kind=int64), self%rows + self%ghosts, stat, errmsg)) return
    allocate (home(size(a, 1), size(self%way%row, kind=int64)))
    if (.not. brought_home(self, as_lane(a), as_lane(home), stat, errmsg)) return
    do k = 1, size(self%way%row, kind=int64)
      a(:, self%way%row(k)) = a(:, self%way%row(k)) + home(:, k)
    end do
  end subroutine

  subroutine add_r8_1(self, a, stat, errmsg)
    class(rcbd_mpi_halo), intent(in) :: self
    real(real64), contiguous, target, intent(inout) :: a(:)
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    real(real64), allocatable, target :: home(:)
    integer(int64) :: k
    if (wrong(self%way, size(a, kind=int64), self%rows + self%ghosts, stat, errmsg)) return
    allocate (home(size(self%way%row, kind=int64)))
    if (.not. brought_home(self, as_lane(a), as_lane(home), stat, errmsg)) return
    do k = 1, size(self%way%row, kind=int64)
      a(self%way%row(k)) = a(self%way%row(k)) + home(k)
    end do
  end subroutine

  subroutine add_r8_2(self, a, stat, errmsg)
    class(rcbd_mpi_halo), intent(in) :: self
    real(real64), contiguous, target, intent(inout) :: a(:, :)
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    real(real64), allocatable, target :: home(:, :)
    integer(int64) :: k
    if (wrong(self%way, size(a, 2, kind=int64), self%rows + self%ghosts, stat, errmsg)) return
    allocate (home(size(a, 1), size(self%way%row, kind=int64)))
    if (.not. brought_home(self, as_lane(a), as_lane(home), stat, errmsg)) return
    do k = 1, size(self%way%row, kind=int64)
      a(:, self%way%row(k)) = a(:, self%way%row(k)) + home(:, k)
    end do
  end subroutine
end module
