! rcbd.f90: module rcbd, the Fortran 2008 interface to rcbd, a service that divides the particles of a simulation into
! balanced parts. Compile this file with your solver, and link with -lrcbd (librcbd.so.1): gfortran rcbd.f90 solver.f90 -lrcbd
!
!   use rcbd
!   type(rcbd_client) :: client
!   type(rcbd_scene) :: scene
!   type(rcbd_step) :: step
!   real(real64) :: x(3, n)
!   call client%connect()
!   call scene%open(client, 'jet', rcbd_scene_options(parts=8, tolerance=0.1_real64))
!   call scene%step(x, step)                                ! at each step; ids=, weights=, options= where needed
!   if (step%report%repartitioned) print *, step%report%reason
!
! rcbd.h, beside this file, is the reference: each procedure does what the function of the same name does there, and each
! option is the one of the same name. Different in Fortran:
!
! Failures. Each procedure has stat= and errmsg=, as allocate() has: stat is 0 or one of the codes below, errmsg the message
! and the hint. Without stat= a failure prints both and ends the program with the exit code 1.
!
! Rows count from 1. Parts, seats and steps count from 0, and arrays by part have the lower bound 0.
!
! Positions are x(dims, n) or an array an axis: scene%step(x, y, z, ...); real32 or real64. Sections such as x(:, 1:n:2) are
! read where they are; a copy is made of those that step backwards, where the step differs from axis to axis, and, by some
! compilers, of components of arrays (atoms%x). ids are int64, or ids4= int32, which are copied. Weights are real64.
! Integers without a kind here are default integers.
!
! What steps and questions tell is copied into allocatable components and arguments: it's yours.
!
! Handles. Variables of the types that extend rcbd_handle are let go of by themselves where they cease to exist, also in
! allocatable arrays; `a = b` makes one more holder. call a%release() lets go before. Main programs and modules keep theirs
! until the end, and with gfortran up to 12 so do `block`s and results of functions: release these. A copy of a type of
! yours that has one as a component may, with gfortran up to 12, only borrow it: it holds as long as the first one does, and
! is a null handle after that. So copy the component by itself as well (`copy%scene = mine%scene`), also where an array of
! such a type is made longer, or keep an array of the handles' own type beside it.
!
! Threads. Pass shared variables that others only read; one that a call changes (open, step, cuts) belongs to one thread.

! What rcbd.h declares, as far as module rcbd needs it. Programs use module rcbd.
module rcbd_c
  use, intrinsic :: iso_c_binding
  implicit none
  public

  type, bind(c) :: c_connect_options
    integer(c_size_t) :: size = 0
    type(c_ptr) :: name = c_null_ptr, token = c_null_ptr, path = c_null_ptr
    real(c_double) :: deadline_seconds = 5
    integer(c_int32_t) :: outlive = 1, reserved = 0
  end type
  type, bind(c) :: c_scene_options
    integer(c_size_t) :: size = 0
    integer(c_int32_t) :: parts = 0, dims = 3
    type(c_ptr) :: method = c_null_ptr, policy = c_null_ptr, positions = c_null_ptr, part_sizes = c_null_ptr
    real(c_double) :: tolerance = 0.1_c_double, axis_hysteresis = 1.2_c_double, cut_tolerance = 0
    integer(c_int32_t) :: replace = 0, threads = 1, seat = 0, seats = 1
    real(c_double) :: deadline_seconds = 60
  end type
  type, bind(c) :: c_positions
    integer(c_size_t) :: size = 0
    integer(c_int64_t) :: count = 0, stride = 1
    integer(c_int32_t) :: dims = 3, single = 0
    type(c_ptr) :: axis(3) = c_null_ptr
  end type
  type, bind(c) :: c_step_options
    integer(c_size_t) :: size = 0
    integer(c_int64_t) :: step = -1
    type(c_ptr) :: ids = c_null_ptr, weights = c_null_ptr
    integer(c_int64_t) :: inserted = 0, removed = 0
    real(c_double) :: step_seconds = -1
    integer(c_int32_t) :: want_parts = 0, want_changed = 0, send = 0, threads = 1
    real(c_double) :: deadline_seconds = 60
  end type
  type, bind(c) :: c_report
    integer(c_size_t) :: size = 0
    integer(c_int64_t) :: step = 0, epoch = 0, n = 0
    real(c_double) :: error_before = 0, error = 0, imbalance = 0
    integer(c_int64_t) :: drifted = 0, moved = 0, migrated = 0, inserted = 0, removed = 0, strangers = 0, &
                          weights_as_zero = 0, positions_step = 0, bytes = 0, scanned = 0, searched = 0, rounds = 0, &
                          reductions = 0
    real(c_double) :: seconds_receive = 0, seconds_exchange = 0, seconds_search = 0, seconds_migrate = 0, seconds_total = 0
    integer(c_int32_t) :: parts = 0, axes_flipped = 0, repartitioned = 0, sent = 0
    type(c_ptr) :: reason = c_null_ptr, way = c_null_ptr, json = c_null_ptr
  end type
  type, bind(c) :: c_cuts_info
    integer(c_size_t) :: size = 0
    integer(c_int64_t) :: epoch = 0, hash = 0
    integer(c_int32_t) :: parts = 0, dims = 0
  end type
  type, bind(c) :: c_near
    integer(c_size_t) :: size = 0
    real(c_double) :: width = 0
    type(c_ptr) :: lo = c_null_ptr, hi = c_null_ptr
    integer(c_int32_t) :: norm = 0, reserved = 0
  end type
  type, bind(c) :: c_ask_options
    integer(c_size_t) :: size = 0
    type(c_ptr) :: ids = c_null_ptr, last_part = c_null_ptr, widths = c_null_ptr
    integer(c_int64_t) :: entries_max = 268435456
    integer(c_int32_t) :: seats = 0, threads = 1
  end type
  type, bind(c) :: c_lists_view
    integer(c_size_t) :: size = 0
    integer(c_int64_t) :: lists = 0, entries = 0
    type(c_ptr) :: offset = c_null_ptr, item = c_null_ptr, shift = c_null_ptr
  end type

  interface
    integer(c_int) function c_version() bind(c, name='rcbd_version')
      import
    end function
    type(c_ptr) function c_code_name(code) bind(c, name='rcbd_code_name')
      import
      integer(c_int), value :: code
    end function
    type(c_ptr) function c_message() bind(c, name='rcbd_message')
      import
    end function
    type(c_ptr) function c_hint() bind(c, name='rcbd_hint')
      import
    end function
    integer(c_size_t) function c_strlen(text) bind(c, name='strlen')
      import
      type(c_ptr), value :: text
    end function
    integer(c_int) function c_lock(mutex) bind(c, name='pthread_mutex_lock')
      import
      integer(c_int64_t), intent(inout) :: mutex(*)
    end function
    integer(c_int) function c_unlock(mutex) bind(c, name='pthread_mutex_unlock')
      import
      integer(c_int64_t), intent(inout) :: mutex(*)
    end function
    subroutine c_exit(code) bind(c, name='exit')
      import
      integer(c_int), value :: code
    end subroutine
    type(c_ptr) function c_retain(handle) bind(c, name='rcbd_retain')
      import
      type(c_ptr), value :: handle
    end function
    subroutine c_release(handle) bind(c, name='rcbd_release')
      import
      type(c_ptr), value :: handle
    end subroutine
    integer(c_int) function c_close(handle) bind(c, name='rcbd_close')
      import
      type(c_ptr), value :: handle
    end function
    integer(c_int) function c_connect(endpoint, options, client) bind(c, name='rcbd_connect')
      import
      type(c_ptr), value :: endpoint
      type(c_connect_options), intent(in) :: options
      type(c_ptr), intent(out) :: client
    end function
    type(c_ptr) function c_notice(client) bind(c, name='rcbd_notice')
      import
      type(c_ptr), value :: client
    end function
    subroutine c_interrupt(client) bind(c, name='rcbd_interrupt')
      import
      type(c_ptr), value :: client
    end subroutine
    integer(c_int) function c_scene_open(client, name, options, scene) bind(c, name='rcbd_scene_open')
      import
      type(c_ptr), value :: client, name
      type(c_scene_options), intent(in) :: options
      type(c_ptr), intent(out) :: scene
    end function
    integer(c_int) function c_scene_drop(client, name) bind(c, name='rcbd_scene_drop')
      import
      type(c_ptr), value :: client, name
    end function
    integer(c_int) function c_last_step(scene, step) bind(c, name='rcbd_last_step')
      import
      type(c_ptr), value :: scene
      integer(c_int64_t), intent(out) :: step
    end function
    integer(c_int) function c_arrays_new(scene, count, layout, single, arrays) bind(c, name='rcbd_arrays_new')
      import
      type(c_ptr), value :: scene
      integer(c_int64_t), value :: count
      integer(c_int), value :: layout
      integer(c_int32_t), value :: single
      type(c_ptr), intent(out) :: arrays
    end function
    integer(c_int) function c_arrays_positions(arrays, positions) bind(c, name='rcbd_arrays_positions')
      import
      type(c_ptr), value :: arrays
      type(c_positions), intent(inout) :: positions
    end function
    integer(c_int) function c_wrap(positions, lo, hi) bind(c, name='rcbd_wrap')
      import
      type(c_positions), intent(in) :: positions
      real(c_double), intent(in) :: lo(*), hi(*)
    end function
    integer(c_int) function c_step(scene, positions, options, result) bind(c, name='rcbd_step')
      import
      type(c_ptr), value :: scene
      type(c_positions), intent(in) :: positions
      type(c_step_options), intent(in) :: options
      type(c_ptr), intent(out) :: result
    end function
    integer(c_int) function c_step_begin(scene, positions, options, op) bind(c, name='rcbd_step_begin')
      import
      type(c_ptr), value :: scene
      type(c_positions), intent(in) :: positions
      type(c_step_options), intent(in) :: options
      type(c_ptr), intent(out) :: op
    end function
    integer(c_int) function c_wait(op, seconds, result) bind(c, name='rcbd_wait')
      import
      type(c_ptr), value :: op
      real(c_double), value :: seconds
      type(c_ptr), intent(out) :: result
    end function
    subroutine c_cancel(op) bind(c, name='rcbd_cancel')
      import
      type(c_ptr), value :: op
    end subroutine
    integer(c_int) function c_result_report(result, report) bind(c, name='rcbd_result_report')
      import
      type(c_ptr), value :: result
      type(c_report), intent(inout) :: report
    end function
    integer(c_int) function c_result_parts(result, part, count) bind(c, name='rcbd_result_parts')
      import
      type(c_ptr), value :: result
      type(c_ptr), intent(out) :: part
      integer(c_int64_t), intent(out) :: count
    end function
    integer(c_int) function c_result_changed(result, row, part, count) bind(c, name='rcbd_result_changed')
      import
      type(c_ptr), value :: result
      type(c_ptr), intent(out) :: row, part
      integer(c_int64_t), intent(out) :: count
    end function
    integer(c_int) function c_result_leaving(result, row, seat, count) bind(c, name='rcbd_result_leaving')
      import
      type(c_ptr), value :: result
      type(c_ptr), intent(out) :: row, seat
      integer(c_int64_t), intent(out) :: count
    end function
    integer(c_int) function c_scene_cuts(scene, cuts) bind(c, name='rcbd_scene_cuts')
      import
      type(c_ptr), value :: scene
      type(c_ptr), intent(out) :: cuts
    end function
    integer(c_int) function c_cuts_describe(cuts, info) bind(c, name='rcbd_cuts_describe')
      import
      type(c_ptr), value :: cuts
      type(c_cuts_info), intent(inout) :: info
    end function
    integer(c_int) function c_cuts_regions(cuts, lo, hi) bind(c, name='rcbd_cuts_regions')
      import
      type(c_ptr), value :: cuts
      real(c_double), intent(out) :: lo(*), hi(*)
    end function
    integer(c_int) function c_cuts_owner(cuts, positions, options, part) bind(c, name='rcbd_cuts_owner')
      import
      type(c_ptr), value :: cuts
      type(c_positions), intent(in) :: positions
      type(c_ask_options), intent(in) :: options
      type(c_ptr), value :: part
    end function
    integer(c_int) function c_cuts_halo(cuts, positions, near, options, lists) bind(c, name='rcbd_cuts_halo')
      import
      type(c_ptr), value :: cuts
      type(c_positions), intent(in) :: positions
      type(c_near), intent(in) :: near
      type(c_ask_options), intent(in) :: options
      type(c_ptr), intent(out) :: lists
    end function
    integer(c_int) function c_cuts_neighbours(cuts, part, near, lists) bind(c, name='rcbd_cuts_neighbours')
      import
      type(c_ptr), value :: cuts
      integer(c_int32_t), value :: part
      type(c_near), intent(in) :: near
      type(c_ptr), intent(out) :: lists
    end function
    integer(c_int) function c_cuts_box(cuts, lo, hi, near, lists) bind(c, name='rcbd_cuts_box')
      import
      type(c_ptr), value :: cuts
      real(c_double), intent(in) :: lo(*), hi(*)
      type(c_near), intent(in) :: near
      type(c_ptr), intent(out) :: lists
    end function
    integer(c_int) function c_cuts_narrowest(cuts, near, part, axis, width) bind(c, name='rcbd_cuts_narrowest')
      import
      type(c_ptr), value :: cuts
      type(c_near), intent(in) :: near
      integer(c_int32_t), intent(out) :: part, axis
      real(c_double), intent(out) :: width
    end function
    integer(c_int) function c_lists_read(lists, view) bind(c, name='rcbd_lists_read')
      import
      type(c_ptr), value :: lists
      type(c_lists_view), intent(inout) :: view
    end function
  end interface
end module

module rcbd
  use rcbd_c
  use, intrinsic :: iso_fortran_env, only: int32, int64, real32, real64, error_unit
  implicit none
  private
  public :: rcbd_version, rcbd_code_name, rcbd_wrap, rcbd_failed

  ! ---- failures: what stat= gives ----
  integer, parameter, public :: rcbd_ok = 0, rcbd_invalid_argument = 1, rcbd_not_found = 2, rcbd_already_exists = 3, &
    rcbd_busy = 4, rcbd_stale_step = 6, rcbd_not_finite = 8, rcbd_protocol_error = 9, rcbd_too_large = 10, &
    rcbd_not_authorised = 11, rcbd_unavailable = 12, rcbd_deadline_exceeded = 13, rcbd_aborted = 14, rcbd_io_error = 15, &
    rcbd_unsupported = 16, rcbd_internal = 17, rcbd_interrupted = 19, rcbd_not_conserved = 20, rcbd_duplicate_id = 21
  integer(int32), parameter, public :: rcbd_max = 0, rcbd_euclid = 1  ! norms

  ! ---- options ----
  ! '' is the default of a text, an array that isn't given is none.
  type, public :: rcbd_connect_options
    character(256) :: name = 'librcbd-fortran', path = ''
    character(1024) :: token = ''
    real(real64) :: deadline_seconds = 5
    logical :: outlive = .true.
  end type
  type, public :: rcbd_scene_options
    integer(int32) :: parts = 0, dims = 3
    character(64) :: method = '', policy = '', positions = ''
    real(real64) :: tolerance = 0.1_real64, axis_hysteresis = 1.2_real64, cut_tolerance = 0
    logical :: replace = .false.
    integer(int32) :: threads = 1, seat = 0, seats = 1
    real(real64) :: deadline_seconds = 60
    real(real64), allocatable :: part_sizes(:)  ! (parts)
  end type
  type, public :: rcbd_step_options
    ! With inserted or removed only the number of particles is checked, not which ones come and go.
    integer(int64) :: step = -1, inserted = 0, removed = 0
    real(real64) :: step_seconds = -1
    logical :: want_parts = .false., want_changed = .false., send = .false.
    integer(int32) :: threads = 1
    real(real64) :: deadline_seconds = 60
  end type
  type, public :: rcbd_near
    real(real64) :: width = 0
    real(real64), allocatable :: lo(:), hi(:)  ! (dims), the periodic box; both or none
    integer(int32) :: norm = rcbd_max
  end type
  type, public :: rcbd_ask_options
    integer(int32), allocatable :: last_part(:)  ! owner: (rows)
    real(real64), allocatable :: widths(:)       ! halo: (rows)
    integer(int64) :: entries_max = 268435456_int64
    integer(int32) :: seats = 0, threads = 1
  end type

  ! ---- what is told ----
  type, public :: rcbd_report
    integer(int64) :: step = -1, epoch = 0, n = 0
    real(real64) :: error_before = 0, error = 0, imbalance = 0
    integer(int64) :: drifted = -1, moved = 0, migrated = 0, inserted = 0, removed = 0, strangers = 0, weights_as_zero = 0, &
                      positions_step = -1, bytes = 0, scanned = 0, searched = 0, rounds = 0, reductions = 0
    real(real64) :: seconds_receive = 0, seconds_exchange = 0, seconds_search = 0, seconds_migrate = 0, seconds_total = 0
    integer(int32) :: parts = 0, axes_flipped = 0
    logical :: repartitioned = .false., sent = .false.
    character(:), allocatable :: reason, way, json
  end type
  ! The result of a step. Row leaving_row(k) goes to seat leaving_seat(k).
  type, public :: rcbd_step
    type(rcbd_report) :: report
    integer(int32), allocatable :: part(:)         ! (rows), with want_parts
    integer(int64), allocatable :: changed_row(:)  ! with want_changed
    integer(int32), allocatable :: changed_part(:)
    integer(int64), allocatable :: leaving_row(:)
    integer(int32), allocatable :: leaving_seat(:)
  end type
  ! Part (or seat) p needs the rows row(offset(p) + 1 : offset(p + 1)), moved by shift(:, ...) periods.
  type, public :: rcbd_halo
    integer(int64), allocatable :: offset(:)    ! (0 : parts)
    integer(int64), allocatable :: row(:)       ! (entries)
    integer(int32), allocatable :: shift(:, :)  ! (dims, entries)
    integer(int64), allocatable :: of_seat(:)   ! (0 : seats - 1): how many of the rows are each seat's, where seats are asked for
  end type

  ! ---- handles ----
  ! Compilers copy handles byte by byte, with temporaries and with components of other types, and may copy them back when
  ! they are long released. So a variable has no more than a slot, whose memory is never freed, and the turn in which it was
  ! given the slot. Only the variable that lies at `home` lets go, and a copy from an older turn is a null handle.
  type :: handle_slot
    type(c_ptr) :: at = c_null_ptr
    integer(int64) :: turn = 0
    integer(c_intptr_t) :: home = 0
    type(handle_slot), pointer :: next => null()  ! of those that are free
  end type
  type, public :: rcbd_handle
    private
    type(handle_slot), pointer :: slot => null()
    integer(int64) :: turn = 0
  contains
    procedure :: release
    procedure :: close => close_handle
    procedure, private :: assign
    generic :: assignment(=) => assign
    final :: finish
  end type
  type, extends(rcbd_handle), public :: rcbd_client
  contains
    procedure :: connect
    procedure :: drop
    procedure :: notice
    procedure :: interrupt
  end type
  type, extends(rcbd_handle), public :: rcbd_scene
  contains
    procedure :: open => open_scene
    procedure :: last_step
    procedure :: cuts => scene_cuts
    procedure, private :: positions_r8, positions_r4
    generic :: positions => positions_r8, positions_r4
    procedure, private :: step_r8, step_r4, step_axes_r8, step_axes_r4
    generic :: step => step_r8, step_r4, step_axes_r8, step_axes_r4
    procedure, private :: begin_r8, begin_r4, begin_axes_r8, begin_axes_r4
    generic :: step_begin => begin_r8, begin_r4, begin_axes_r8, begin_axes_r4
  end type
  type, extends(rcbd_handle), public :: rcbd_op
  contains
    procedure :: wait => wait_op
    procedure :: cancel
  end type
  ! Holds what scene%positions() gave.
  type, extends(rcbd_handle), public :: rcbd_memory
  end type
  type, extends(rcbd_handle), public :: rcbd_cuts
  contains
    procedure :: epoch
    procedure :: hash      ! the bits; print them by '(z16.16)'
    procedure :: hex_hash  ! as the service prints it
    procedure :: parts
    procedure :: dims
    procedure :: regions
    procedure :: neighbours
    procedure :: box
    procedure :: narrowest
    procedure, private :: owner_r8, owner_r4, owner_axes_r8, owner_axes_r4
    generic :: owner => owner_r8, owner_r4, owner_axes_r8, owner_axes_r4
    procedure, private :: halo_r8, halo_r4, halo_axes_r8, halo_axes_r4
    generic :: halo => halo_r8, halo_r4, halo_axes_r8, halo_axes_r4
  end type

  interface rcbd_wrap
    module procedure wrap_r8, wrap_r4, wrap_axes_r8, wrap_axes_r4
  end interface

  ! Positions of the caller's as C takes them. Where C can't, copies are kept here.
  type :: given
    type(c_positions) :: at
    real(real64), allocatable :: copy(:, :), weights(:)
    integer(int64), allocatable :: ids(:)
    character(:), allocatable :: wrong
  end type
  interface take
    module procedure take_r8, take_r4, take_axes_r8, take_axes_r4
  end interface
  interface place
    module procedure place_r8, place_r4
  end interface
  real(real64), target, save :: nothing(3) = 0  ! where no rows are
  type(handle_slot), pointer, save :: free_slot => null()
  integer(int64), save :: slots_lock(16) = 0  ! a pthread_mutex_t, which is shorter; zeros are PTHREAD_MUTEX_INITIALIZER
  character(*), parameter :: no_copy = 'step_begin makes no copies, since the step goes on: give sections that step forward ' // &
    'and arrays that are contiguous'

contains

  ! ---- failures ----

  ! Of the library, as 10000 major + 100 minor + patch.
  integer function rcbd_version()
    rcbd_version = c_version()
  end function

  function rcbd_code_name(code) result(name)
    integer, intent(in) :: code
    character(:), allocatable :: name
    name = text_at(c_code_name(int(code, c_int)))
  end function

  ! Tells a failure as each procedure here does: by stat and errmsg or, without stat, by ending the program. exit() ends it
  ! as `error stop` does, without a list of this module's procedures.
  subroutine rcbd_failed(code, message, stat, errmsg)
    integer, intent(in) :: code
    character(*), intent(in) :: message
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    if (present(errmsg)) errmsg = message
    if (present(stat)) then
      stat = code
    else
      write (error_unit, '(4a)') rcbd_code_name(code), ': ', message
      call c_exit(1_c_int)
    end if
  end subroutine

  ! Whether a call of the library has failed; tells it then.
  logical function bad(code, stat, errmsg)
    integer(c_int), intent(in) :: code
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    character(:), allocatable :: message, hint
    bad = code /= rcbd_ok
    if (present(stat)) stat = rcbd_ok
    if (.not. bad) return
    message = text_at(c_message())
    hint = text_at(c_hint())
    if (len(hint) > 0) message = message // '; ' // hint
    call rcbd_failed(int(code), message, stat, errmsg)
  end function

  ! Whether these rows or arrays can't be what they should be; tells it then.
  logical function refused(wrong, message, stat, errmsg)
    logical, intent(in) :: wrong
    character(*), intent(in) :: message
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    refused = wrong
    if (present(stat)) stat = rcbd_ok
    if (wrong) call rcbd_failed(rcbd_invalid_argument, message, stat, errmsg)
  end function

  ! ---- texts and memory of C ----

  function text_at(at) result(text)
    type(c_ptr), intent(in) :: at
    character(:), allocatable :: text
    character(kind=c_char), pointer :: letters(:)
    integer(c_size_t) :: k
    if (.not. c_associated(at)) then
      text = ''
      return
    end if
    call c_f_pointer(at, letters, [c_strlen(at)])
    allocate (character(size(letters)) :: text)
    do k = 1, size(letters, kind=c_size_t)
      text(k:k) = letters(k)
    end do
  end function

  ! A text of the caller's, for C: `kept` has it as long as it is read; '' is null.
  type(c_ptr) function c_text(text, kept)
    character(*), intent(in) :: text
    character(kind=c_char), allocatable, target, intent(out) :: kept(:)
    integer :: k
    allocate (kept(len_trim(text) + 1))
    do k = 1, len_trim(text)
      kept(k) = text(k:k)
    end do
    kept(size(kept)) = c_null_char
    c_text = c_null_ptr
    if (size(kept) > 1) c_text = c_loc(kept)
  end function

  integer(c_intptr_t) function address(at)
    type(c_ptr), intent(in) :: at
    address = transfer(at, 0_c_intptr_t)
  end function

  ! Rows of C count from 0.
  subroutine get_rows(at, count, row)
    type(c_ptr), intent(in) :: at
    integer(int64), intent(in) :: count
    integer(int64), allocatable, intent(inout) :: row(:)
    integer(int64), pointer :: from(:)
    if (allocated(row)) deallocate (row)
    allocate (row(count))
    if (count == 0) return
    call c_f_pointer(at, from, [count])
    row = from + 1
  end subroutine

  subroutine get_numbers(at, count, number)
    type(c_ptr), intent(in) :: at
    integer(int64), intent(in) :: count
    integer(int32), allocatable, intent(inout) :: number(:)
    integer(int32), pointer :: from(:)
    if (allocated(number)) deallocate (number)
    allocate (number(count))
    if (count == 0) return
    call c_f_pointer(at, from, [count])
    number = from
  end subroutine

  pure integer(c_int32_t) function flag(on)
    logical, intent(in) :: on
    flag = merge(1_c_int32_t, 0_c_int32_t, on)
  end function

  ! ---- positions ----

  ! Elements from one row to the next; not above 0 where C can't go that way.
  integer(int64) function stride_of(first, second, bytes)
    type(c_ptr), intent(in) :: first, second
    integer, intent(in) :: bytes
    stride_of = address(second) - address(first)
    if (mod(stride_of, int(bytes, int64)) /= 0) stride_of = 0
    stride_of = stride_of / bytes
  end function

  ! What lies in copy is given to C in its place.
  subroutine give_copy(rows)
    type(given), intent(inout), target :: rows
    integer :: a
    rows%at%single = 0
    rows%at%stride = rows%at%dims
    do a = 1, rows%at%dims
      rows%at%axis(a) = c_loc(rows%copy(a, 1))
    end do
  end subroutine

  subroutine begin_take(rows, dims, count, single)
    type(given), intent(inout) :: rows
    integer, intent(in) :: dims
    integer(int64), intent(in) :: count
    integer(c_int32_t), intent(in) :: single
    integer :: a
    rows%at%size = c_sizeof(rows%at)
    rows%at%dims = int(dims, c_int32_t)
    rows%at%count = count
    rows%at%single = single
    if (dims > 3 .or. dims < 1) rows%wrong = 'positions are x(dims, n) with 1 to 3 dims; turn yours, as by transpose()'
    do a = 1, min(dims, 3)
      rows%at%axis(a) = c_loc(nothing(a))
    end do
  end subroutine

  subroutine take_r8(rows, x)
    type(given), intent(inout), target :: rows
    real(real64), intent(in), target :: x(:, :)
    integer :: a
    call begin_take(rows, size(x, 1), size(x, 2, kind=int64), 0_c_int32_t)
    if (size(x, kind=int64) == 0 .or. allocated(rows%wrong)) return
    do a = 1, size(x, 1)
      rows%at%axis(a) = c_loc(x(a, 1))
    end do
    if (size(x, 2, kind=int64) > 1) rows%at%stride = stride_of(c_loc(x(1, 1)), c_loc(x(1, 2)), 8)
    if (rows%at%stride > 0) return
    allocate (rows%copy(size(x, 1), size(x, 2, kind=int64)))
    rows%copy(:, :) = x
    call give_copy(rows)
  end subroutine

  subroutine take_axes_r8(rows, x, y, z)
    type(given), intent(inout), target :: rows
    real(real64), intent(in), target :: x(:)
    real(real64), intent(in), target, optional :: y(:), z(:)
    integer(int64) :: stride(3)
    integer :: dims
    dims = 1
    stride = 1
    if (present(y)) dims = 2
    if (present(z)) dims = 3
    call begin_take(rows, dims, size(x, kind=int64), 0_c_int32_t)
    if (present(z) .and. .not. present(y)) rows%wrong = 'there is an array z, but no y'
    call place(rows, 1, stride, x)
    if (present(y)) call place(rows, 2, stride, y)
    if (present(z)) call place(rows, 3, stride, z)
    if (size(x, kind=int64) == 0 .or. allocated(rows%wrong)) return
    rows%at%stride = stride(1)
    if (all(stride(:dims) == stride(1)) .and. stride(1) > 0) return
    allocate (rows%copy(dims, size(x, kind=int64)))
    rows%copy(1, :) = x
    if (present(y)) rows%copy(2, :) = y
    if (present(z)) rows%copy(3, :) = z
    call give_copy(rows)
  end subroutine

  subroutine place_r8(rows, axis, stride, x)
    type(given), intent(inout) :: rows
    integer, intent(in) :: axis
    integer(int64), intent(inout) :: stride(3)
    real(real64), intent(in), target :: x(:)
    if (size(x, kind=int64) /= rows%at%count) rows%wrong = 'the arrays of the axes differ in length'
    if (size(x, kind=int64) > 0) rows%at%axis(axis) = c_loc(x(1))
    if (size(x, kind=int64) > 1) stride(axis) = stride_of(c_loc(x(1)), c_loc(x(2)), 8)
  end subroutine

  subroutine take_r4(rows, x)
    type(given), intent(inout), target :: rows
    real(real32), intent(in), target :: x(:, :)
    integer :: a
    call begin_take(rows, size(x, 1), size(x, 2, kind=int64), 1_c_int32_t)
    if (size(x, kind=int64) == 0 .or. allocated(rows%wrong)) return
    do a = 1, size(x, 1)
      rows%at%axis(a) = c_loc(x(a, 1))
    end do
    if (size(x, 2, kind=int64) > 1) rows%at%stride = stride_of(c_loc(x(1, 1)), c_loc(x(1, 2)), 4)
    if (rows%at%stride > 0) return
    allocate (rows%copy(size(x, 1), size(x, 2, kind=int64)))
    rows%copy(:, :) = x
    call give_copy(rows)
  end subroutine

  subroutine take_axes_r4(rows, x, y, z)
    type(given), intent(inout), target :: rows
    real(real32), intent(in), target :: x(:)
    real(real32), intent(in), target, optional :: y(:), z(:)
    integer(int64) :: stride(3)
    integer :: dims
    dims = 1
    stride = 1
    if (present(y)) dims = 2
    if (present(z)) dims = 3
    call begin_take(rows, dims, size(x, kind=int64), 1_c_int32_t)
    if (present(z) .and. .not. present(y)) rows%wrong = 'there is an array z, but no y'
    call place(rows, 1, stride, x)
    if (present(y)) call place(rows, 2, stride, y)
    if (present(z)) call place(rows, 3, stride, z)
    if (size(x, kind=int64) == 0 .or. allocated(rows%wrong)) return
    rows%at%stride = stride(1)
    if (all(stride(:dims) == stride(1)) .and. stride(1) > 0) return
    allocate (rows%copy(dims, size(x, kind=int64)))
    rows%copy(1, :) = x
    if (present(y)) rows%copy(2, :) = y
    if (present(z)) rows%copy(3, :) = z
    call give_copy(rows)
  end subroutine

  subroutine place_r4(rows, axis, stride, x)
    type(given), intent(inout) :: rows
    integer, intent(in) :: axis
    integer(int64), intent(inout) :: stride(3)
    real(real32), intent(in), target :: x(:)
    if (size(x, kind=int64) /= rows%at%count) rows%wrong = 'the arrays of the axes differ in length'
    if (size(x, kind=int64) > 0) rows%at%axis(axis) = c_loc(x(1))
    if (size(x, kind=int64) > 1) stride(axis) = stride_of(c_loc(x(1)), c_loc(x(2)), 4)
  end subroutine

  ! Ids of the rows, for C; null where there are none.
  type(c_ptr) function ids_of(rows, ids, ids4)
    type(given), intent(inout), target :: rows
    integer(int64), intent(in), target, optional :: ids(:)
    integer(int32), intent(in), optional :: ids4(:)
    integer(int64) :: number
    ids_of = c_null_ptr
    if (.not. (present(ids) .or. present(ids4))) return
    ids_of = c_loc(nothing)
    if (present(ids)) then
      number = size(ids, kind=int64)
      if (is_contiguous(ids)) then
        if (number > 0) ids_of = c_loc(ids(1))
      else
        allocate (rows%ids(number))
        rows%ids(:) = ids
      end if
    else
      number = size(ids4, kind=int64)
      allocate (rows%ids(number))
      rows%ids(:) = ids4
    end if
    if (allocated(rows%ids) .and. number > 0) ids_of = c_loc(rows%ids(1))
    if (present(ids) .and. present(ids4)) rows%wrong = 'there are both ids and ids4'
    if (number /= rows%at%count) rows%wrong = 'ids has another length than the positions have rows'
  end function

  type(c_ptr) function weights_of(rows, weights)
    type(given), intent(inout), target :: rows
    real(real64), intent(in), target, optional :: weights(:)
    weights_of = c_null_ptr
    if (.not. present(weights)) return
    weights_of = c_loc(nothing)
    if (size(weights, kind=int64) /= rows%at%count) rows%wrong = 'weights has another length than the positions have rows'
    if (size(weights, kind=int64) == 0) return
    if (is_contiguous(weights)) then
      weights_of = c_loc(weights(1))
    else
      allocate (rows%weights(size(weights, kind=int64)))
      rows%weights(:) = weights
      weights_of = c_loc(rows%weights(1))
    end if
  end function

  subroutine wrap_given(rows, lo, hi, stat, errmsg)
    type(given), intent(in) :: rows
    real(real64), intent(in) :: lo(:), hi(:)
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    if (is_wrong(rows, stat, errmsg)) return
    if (refused(size(lo) /= rows%at%dims .or. size(hi) /= rows%at%dims, &
                'lo and hi of the box have other lengths than the positions have dims', stat, errmsg)) return
    if (bad(c_wrap(rows%at, lo, hi), stat, errmsg)) return
  end subroutine

  logical function is_wrong(rows, stat, errmsg)
    type(given), intent(in) :: rows
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    is_wrong = allocated(rows%wrong)
    if (is_wrong) call rcbd_failed(rcbd_invalid_argument, rows%wrong, stat, errmsg)
  end function

  subroutine wrap_r8(x, lo, hi, stat, errmsg)
    real(real64), intent(inout), contiguous, target :: x(:, :)
    real(real64), intent(in) :: lo(:), hi(:)
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(given), target :: rows
    call take(rows, x)
    call wrap_given(rows, lo, hi, stat, errmsg)
  end subroutine

  subroutine wrap_axes_r8(x, y, z, lo, hi, stat, errmsg)
    real(real64), intent(inout), contiguous, target :: x(:)
    real(real64), intent(inout), contiguous, target, optional :: y(:), z(:)
    real(real64), intent(in) :: lo(:), hi(:)
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(given), target :: rows
    call take(rows, x, y, z)
    call wrap_given(rows, lo, hi, stat, errmsg)
  end subroutine

  subroutine wrap_r4(x, lo, hi, stat, errmsg)
    real(real32), intent(inout), contiguous, target :: x(:, :)
    real(real64), intent(in) :: lo(:), hi(:)
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(given), target :: rows
    call take(rows, x)
    call wrap_given(rows, lo, hi, stat, errmsg)
  end subroutine

  subroutine wrap_axes_r4(x, y, z, lo, hi, stat, errmsg)
    real(real32), intent(inout), contiguous, target :: x(:)
    real(real32), intent(inout), contiguous, target, optional :: y(:), z(:)
    real(real64), intent(in) :: lo(:), hi(:)
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(given), target :: rows
    call take(rows, x, y, z)
    call wrap_given(rows, lo, hi, stat, errmsg)
  end subroutine

  ! ---- handles ----

  ! What the library takes: null where the variable holds nothing.
  type(c_ptr) function live(self)
    class(rcbd_handle), intent(in) :: self
    live = c_null_ptr
    if (.not. associated(self%slot)) return
    if (self%slot%turn == self%turn) live = self%slot%at
  end function

  ! Takes over a handle that the library gave.
  subroutine hold(self, at)
    class(rcbd_handle), intent(inout), target :: self
    type(c_ptr), intent(in) :: at
    call self%release()
    if (.not. c_associated(at)) return
    if (c_lock(slots_lock) /= 0) return
    self%slot => free_slot
    if (associated(free_slot)) free_slot => free_slot%next
    if (c_unlock(slots_lock) /= 0) return
    if (.not. associated(self%slot)) allocate (self%slot)
    self%slot%at = at
    self%slot%home = address(c_loc(self%turn))
    self%turn = self%slot%turn
  end subroutine

  impure elemental subroutine release(self)
    class(rcbd_handle), intent(inout), target :: self
    type(handle_slot), pointer :: slot
    slot => self%slot
    nullify (self%slot)
    if (.not. associated(slot)) return
    if (slot%turn /= self%turn .or. slot%home /= address(c_loc(self%turn))) return
    slot%turn = slot%turn + 1
    call c_release(slot%at)
    if (c_lock(slots_lock) /= 0) return
    slot%next => free_slot
    free_slot => slot
    if (c_unlock(slots_lock) /= 0) return
  end subroutine

  impure elemental subroutine finish(self)
    type(rcbd_handle), intent(inout) :: self
    call self%release()
  end subroutine

  impure elemental subroutine assign(to, from)
    class(rcbd_handle), intent(inout) :: to
    class(rcbd_handle), intent(in) :: from
    if (.not. same_type_as(to, from)) call rcbd_failed(rcbd_invalid_argument, 'a handle is assigned to one of another type')
    call hold(to, c_retain(live(from)))
  end subroutine

  ! A scene: lets go of it in the service. A client: closes its scenes and says goodbye.
  subroutine close_handle(self, stat, errmsg)
    class(rcbd_handle), intent(in) :: self
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    if (bad(c_close(live(self)), stat, errmsg)) return
  end subroutine

  ! ---- client ----

  subroutine connect(self, endpoint, options, stat, errmsg)
    class(rcbd_client), intent(inout) :: self
    character(*), intent(in), optional :: endpoint
    type(rcbd_connect_options), intent(in), optional :: options
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(rcbd_connect_options) :: o
    type(c_connect_options) :: c
    type(c_ptr) :: place, at
    character(kind=c_char), allocatable, target :: text(:), name(:), token(:), path(:)
    if (present(options)) o = options
    place = c_null_ptr
    if (present(endpoint)) place = c_text(endpoint, text)
    c%size = c_sizeof(c)
    c%name = c_text(o%name, name)
    c%token = c_text(o%token, token)
    c%path = c_text(o%path, path)
    c%deadline_seconds = o%deadline_seconds
    c%outlive = flag(o%outlive)
    if (bad(c_connect(place, c, at), stat, errmsg)) return
    call hold(self, at)
  end subroutine

  subroutine drop(self, name, stat, errmsg)
    class(rcbd_client), intent(in) :: self
    character(*), intent(in) :: name
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    character(kind=c_char), allocatable, target :: text(:)
    if (bad(c_scene_drop(live(self), c_text(name, text)), stat, errmsg)) return
  end subroutine

  ! Whether there was one more notice: do while (client%notice(text)).
  logical function notice(self, text)
    class(rcbd_client), intent(in) :: self
    character(:), allocatable, intent(inout) :: text
    type(c_ptr) :: at
    at = c_notice(live(self))
    notice = c_associated(at)
    text = text_at(at)
  end function

  subroutine interrupt(self)
    class(rcbd_client), intent(in) :: self
    call c_interrupt(live(self))
  end subroutine

  ! ---- scene ----

  subroutine open_scene(self, client, name, options, stat, errmsg)
    class(rcbd_scene), intent(inout) :: self
    class(rcbd_client), intent(in) :: client
    character(*), intent(in) :: name
    type(rcbd_scene_options), intent(in), optional, target :: options
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(c_scene_options) :: c
    type(c_ptr) :: at
    character(kind=c_char), allocatable, target :: text(:), method(:), policy(:), positions(:)
    c%size = c_sizeof(c)
    if (present(options)) then
      c%parts = options%parts
      c%dims = options%dims
      c%method = c_text(options%method, method)
      c%policy = c_text(options%policy, policy)
      c%positions = c_text(options%positions, positions)
      if (allocated(options%part_sizes)) then
        if (refused(size(options%part_sizes) /= options%parts, 'part_sizes has another length than there are parts', &
                    stat, errmsg)) return
        if (options%parts > 0) c%part_sizes = c_loc(options%part_sizes)
      end if
      c%tolerance = options%tolerance
      c%axis_hysteresis = options%axis_hysteresis
      c%cut_tolerance = options%cut_tolerance
      c%replace = flag(options%replace)
      c%threads = options%threads
      c%seat = options%seat
      c%seats = options%seats
      c%deadline_seconds = options%deadline_seconds
    end if
    call self%release()  ! what it was: so a scene can be opened anew
    if (bad(c_scene_open(live(client), c_text(name, text), c, at), stat, errmsg)) return
    call hold(self, at)
  end subroutine

  ! -1: there was none.
  integer(int64) function last_step(self, stat, errmsg)
    class(rcbd_scene), intent(in) :: self
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    if (bad(c_last_step(live(self), last_step), stat, errmsg)) return
  end function

  ! The cuts after the last step.
  subroutine scene_cuts(self, cuts, stat, errmsg)
    class(rcbd_scene), intent(in) :: self
    class(rcbd_cuts), intent(inout) :: cuts
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(c_ptr) :: at
    if (bad(c_scene_cuts(live(self), at), stat, errmsg)) return
    call hold(cuts, at)
  end subroutine

  ! x(dims, n) in memory that the service may read in place, as long as `memory` holds it.
  subroutine positions_r8(self, n, x, memory, stat, errmsg)
    class(rcbd_scene), intent(in) :: self
    integer, intent(in) :: n
    real(real64), pointer, intent(out) :: x(:, :)
    class(rcbd_memory), intent(inout) :: memory
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(c_positions) :: to
    nullify (x)
    call new_memory(self, n, 0_c_int32_t, memory, to, stat, errmsg)
    if (c_associated(to%axis(1))) call c_f_pointer(to%axis(1), x, [int(to%dims, int64), to%count])
  end subroutine

  subroutine positions_r4(self, n, x, memory, stat, errmsg)
    class(rcbd_scene), intent(in) :: self
    integer, intent(in) :: n
    real(real32), pointer, intent(out) :: x(:, :)
    class(rcbd_memory), intent(inout) :: memory
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(c_positions) :: to
    nullify (x)
    call new_memory(self, n, 1_c_int32_t, memory, to, stat, errmsg)
    if (c_associated(to%axis(1))) call c_f_pointer(to%axis(1), x, [int(to%dims, int64), to%count])
  end subroutine

  subroutine new_memory(self, n, single, memory, to, stat, errmsg)
    class(rcbd_scene), intent(in) :: self
    integer, intent(in) :: n
    integer(c_int32_t), intent(in) :: single
    class(rcbd_memory), intent(inout) :: memory
    type(c_positions), intent(out) :: to
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(c_ptr) :: at
    if (bad(c_arrays_new(live(self), int(n, c_int64_t), 0_c_int, single, at), stat, errmsg)) return
    call hold(memory, at)
    to%size = c_sizeof(to)
    if (bad(c_arrays_positions(at, to), stat, errmsg)) return
  end subroutine

  ! ---- steps ----

  subroutine as_c(options, c)
    type(rcbd_step_options), intent(in), optional :: options
    type(c_step_options), intent(inout) :: c
    c%size = c_sizeof(c)
    if (.not. present(options)) return
    c%step = options%step
    c%inserted = options%inserted
    c%removed = options%removed
    c%step_seconds = options%step_seconds
    c%want_parts = flag(options%want_parts)
    c%want_changed = flag(options%want_changed)
    c%send = flag(options%send)
    c%threads = options%threads
    c%deadline_seconds = options%deadline_seconds
  end subroutine

  subroutine make_step(self, rows, result, ids, ids4, weights, options, stat, errmsg)
    class(rcbd_scene), intent(in) :: self
    type(given), intent(inout), target :: rows
    type(rcbd_step), intent(inout), optional :: result
    integer(int64), intent(in), target, optional :: ids(:)
    integer(int32), intent(in), optional :: ids4(:)
    real(real64), intent(in), target, optional :: weights(:)
    type(rcbd_step_options), intent(in), optional :: options
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(c_step_options) :: c
    type(c_ptr) :: made
    call as_c(options, c)
    c%ids = ids_of(rows, ids, ids4)
    c%weights = weights_of(rows, weights)
    if (is_wrong(rows, stat, errmsg)) return
    if (bad(c_step(live(self), rows%at, c, made), stat, errmsg)) return
    if (present(result)) call read_result(made, result)
    call c_release(made)
  end subroutine

  subroutine begin_step(self, rows, op, ids, weights, options, stat, errmsg)
    class(rcbd_scene), intent(in) :: self
    type(given), intent(inout), target :: rows
    class(rcbd_op), intent(inout) :: op
    integer(int64), intent(in), target, optional :: ids(:)
    real(real64), intent(in), target, optional :: weights(:)
    type(rcbd_step_options), intent(in), optional :: options
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(c_step_options) :: c
    type(c_ptr) :: at
    call as_c(options, c)
    c%ids = ids_of(rows, ids)
    c%weights = weights_of(rows, weights)
    if (allocated(rows%copy) .or. allocated(rows%ids) .or. allocated(rows%weights)) rows%wrong = no_copy
    if (is_wrong(rows, stat, errmsg)) return
    if (bad(c_step_begin(live(self), rows%at, c, at), stat, errmsg)) return
    call hold(op, at)
  end subroutine

  ! All of a result that is there.
  subroutine read_result(at, to)
    type(c_ptr), intent(in) :: at
    type(rcbd_step), intent(inout) :: to
    type(c_ptr) :: row, number
    integer(c_int64_t) :: count
    call read_report(at, to%report)
    if (allocated(to%part)) deallocate (to%part)
    if (c_result_parts(at, number, count) == rcbd_ok) call get_numbers(number, count, to%part)
    if (allocated(to%changed_row)) deallocate (to%changed_row, to%changed_part)
    if (c_result_changed(at, row, number, count) == rcbd_ok) then
      call get_rows(row, count, to%changed_row)
      call get_numbers(number, count, to%changed_part)
    end if
    if (c_result_leaving(at, row, number, count) == rcbd_ok) then
      call get_rows(row, count, to%leaving_row)
      call get_numbers(number, count, to%leaving_seat)
    end if
  end subroutine

  subroutine read_report(at, to)
    type(c_ptr), intent(in) :: at
    type(rcbd_report), intent(inout) :: to
    type(c_report) :: c
    c%size = c_sizeof(c)
    if (c_result_report(at, c) /= rcbd_ok) return
    to%step = c%step
    to%epoch = c%epoch
    to%n = c%n
    to%error_before = c%error_before
    to%error = c%error
    to%imbalance = c%imbalance
    to%drifted = c%drifted
    to%moved = c%moved
    to%migrated = c%migrated
    to%inserted = c%inserted
    to%removed = c%removed
    to%strangers = c%strangers
    to%weights_as_zero = c%weights_as_zero
    to%positions_step = c%positions_step
    to%bytes = c%bytes
    to%scanned = c%scanned
    to%searched = c%searched
    to%rounds = c%rounds
    to%reductions = c%reductions
    to%seconds_receive = c%seconds_receive
    to%seconds_exchange = c%seconds_exchange
    to%seconds_search = c%seconds_search
    to%seconds_migrate = c%seconds_migrate
    to%seconds_total = c%seconds_total
    to%parts = c%parts
    to%axes_flipped = c%axes_flipped
    to%repartitioned = c%repartitioned /= 0
    to%sent = c%sent /= 0
    to%reason = text_at(c%reason)
    to%way = text_at(c%way)
    to%json = text_at(c%json)
  end subroutine

  ! Waits until the step is done or, where `seconds` says so, at most so long; then `done` tells.
  subroutine wait_op(self, result, seconds, done, stat, errmsg)
    class(rcbd_op), intent(in) :: self
    type(rcbd_step), intent(inout), optional :: result
    real(real64), intent(in), optional :: seconds
    logical, intent(out), optional :: done
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(c_ptr) :: made
    real(c_double) :: longest
    integer(c_int) :: code
    longest = -1
    if (present(seconds)) longest = seconds
    code = c_wait(live(self), longest, made)
    if (present(done)) done = code /= -1
    if (code == -1) code = rcbd_ok  ! pending
    if (bad(code, stat, errmsg)) return
    if (present(result) .and. c_associated(made)) call read_result(made, result)
    call c_release(made)
  end subroutine

  subroutine cancel(self)
    class(rcbd_op), intent(in) :: self
    call c_cancel(live(self))
  end subroutine

  ! What step() says of rows, for an array of rows or one an axis.
  subroutine step_r8(self, x, result, ids, ids4, weights, options, stat, errmsg)
    class(rcbd_scene), intent(in) :: self
    real(real64), intent(in), target :: x(:, :)
    type(rcbd_step), intent(inout), optional :: result
    integer(int64), intent(in), target, optional :: ids(:)
    integer(int32), intent(in), optional :: ids4(:)
    real(real64), intent(in), target, optional :: weights(:)
    type(rcbd_step_options), intent(in), optional :: options
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(given), target :: rows
    call take(rows, x)
    call make_step(self, rows, result, ids, ids4, weights, options, stat, errmsg)
  end subroutine

  subroutine step_axes_r8(self, x, y, z, result, ids, ids4, weights, options, stat, errmsg)
    class(rcbd_scene), intent(in) :: self
    real(real64), intent(in), target :: x(:)
    real(real64), intent(in), target, optional :: y(:), z(:)
    type(rcbd_step), intent(inout), optional :: result
    integer(int64), intent(in), target, optional :: ids(:)
    integer(int32), intent(in), optional :: ids4(:)
    real(real64), intent(in), target, optional :: weights(:)
    type(rcbd_step_options), intent(in), optional :: options
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(given), target :: rows
    call take(rows, x, y, z)
    call make_step(self, rows, result, ids, ids4, weights, options, stat, errmsg)
  end subroutine

  subroutine step_r4(self, x, result, ids, ids4, weights, options, stat, errmsg)
    class(rcbd_scene), intent(in) :: self
    real(real32), intent(in), target :: x(:, :)
    type(rcbd_step), intent(inout), optional :: result
    integer(int64), intent(in), target, optional :: ids(:)
    integer(int32), intent(in), optional :: ids4(:)
    real(real64), intent(in), target, optional :: weights(:)
    type(rcbd_step_options), intent(in), optional :: options
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(given), target :: rows
    call take(rows, x)
    call make_step(self, rows, result, ids, ids4, weights, options, stat, errmsg)
  end subroutine

  subroutine step_axes_r4(self, x, y, z, result, ids, ids4, weights, options, stat, errmsg)
    class(rcbd_scene), intent(in) :: self
    real(real32), intent(in), target :: x(:)
    real(real32), intent(in), target, optional :: y(:), z(:)
    type(rcbd_step), intent(inout), optional :: result
    integer(int64), intent(in), target, optional :: ids(:)
    integer(int32), intent(in), optional :: ids4(:)
    real(real64), intent(in), target, optional :: weights(:)
    type(rcbd_step_options), intent(in), optional :: options
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(given), target :: rows
    call take(rows, x, y, z)
    call make_step(self, rows, result, ids, ids4, weights, options, stat, errmsg)
  end subroutine

  ! The arrays are read until wait() says that the step is done. So let them have the attributes `target` and `asynchronous`,
  ! and pass them whole or as x(:, i:j:k): of other sections and of expressions the compiler gives a copy, which is gone then.
  subroutine begin_r8(self, x, op, ids, weights, options, stat, errmsg)
    class(rcbd_scene), intent(in) :: self
    real(real64), intent(in), asynchronous, target :: x(:, :)
    class(rcbd_op), intent(inout) :: op
    integer(int64), intent(in), asynchronous, target, optional :: ids(:)
    real(real64), intent(in), asynchronous, target, optional :: weights(:)
    type(rcbd_step_options), intent(in), optional :: options
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(given), target :: rows
    call take(rows, x)
    call begin_step(self, rows, op, ids, weights, options, stat, errmsg)
  end subroutine

  subroutine begin_axes_r8(self, x, y, z, op, ids, weights, options, stat, errmsg)
    class(rcbd_scene), intent(in) :: self
    real(real64), intent(in), asynchronous, target :: x(:)
    real(real64), intent(in), asynchronous, target, optional :: y(:), z(:)
    class(rcbd_op), intent(inout) :: op
    integer(int64), intent(in), asynchronous, target, optional :: ids(:)
    real(real64), intent(in), asynchronous, target, optional :: weights(:)
    type(rcbd_step_options), intent(in), optional :: options
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(given), target :: rows
    call take(rows, x, y, z)
    call begin_step(self, rows, op, ids, weights, options, stat, errmsg)
  end subroutine

  subroutine begin_r4(self, x, op, ids, weights, options, stat, errmsg)
    class(rcbd_scene), intent(in) :: self
    real(real32), intent(in), asynchronous, target :: x(:, :)
    class(rcbd_op), intent(inout) :: op
    integer(int64), intent(in), asynchronous, target, optional :: ids(:)
    real(real64), intent(in), asynchronous, target, optional :: weights(:)
    type(rcbd_step_options), intent(in), optional :: options
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(given), target :: rows
    call take(rows, x)
    call begin_step(self, rows, op, ids, weights, options, stat, errmsg)
  end subroutine

  subroutine begin_axes_r4(self, x, y, z, op, ids, weights, options, stat, errmsg)
    class(rcbd_scene), intent(in) :: self
    real(real32), intent(in), asynchronous, target :: x(:)
    real(real32), intent(in), asynchronous, target, optional :: y(:), z(:)
    class(rcbd_op), intent(inout) :: op
    integer(int64), intent(in), asynchronous, target, optional :: ids(:)
    real(real64), intent(in), asynchronous, target, optional :: weights(:)
    type(rcbd_step_options), intent(in), optional :: options
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(given), target :: rows
    call take(rows, x, y, z)
    call begin_step(self, rows, op, ids, weights, options, stat, errmsg)
  end subroutine

  ! ---- cuts ----

  subroutine describe(self, info, stat, errmsg)
    class(rcbd_cuts), intent(in) :: self
    type(c_cuts_info), intent(out) :: info
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    info%size = c_sizeof(info)
    if (bad(c_cuts_describe(live(self), info), stat, errmsg)) return
  end subroutine

  integer(int64) function epoch(self, stat, errmsg)
    class(rcbd_cuts), intent(in) :: self
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(c_cuts_info) :: info
    call describe(self, info, stat, errmsg)
    epoch = info%epoch
  end function

  integer(int64) function hash(self, stat, errmsg)
    class(rcbd_cuts), intent(in) :: self
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(c_cuts_info) :: info
    call describe(self, info, stat, errmsg)
    hash = info%hash
  end function

  integer(int32) function parts(self, stat, errmsg)
    class(rcbd_cuts), intent(in) :: self
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(c_cuts_info) :: info
    call describe(self, info, stat, errmsg)
    parts = info%parts
  end function

  integer(int32) function dims(self, stat, errmsg)
    class(rcbd_cuts), intent(in) :: self
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(c_cuts_info) :: info
    call describe(self, info, stat, errmsg)
    dims = info%dims
  end function

  character(16) function hex_hash(self, stat, errmsg)
    class(rcbd_cuts), intent(in) :: self
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    integer(int64) :: bits
    bits = self%hash(stat, errmsg)
    write (hex_hash, '(z16.16)') bits
    hex_hash = lower(hex_hash)
  end function

  pure character(16) function lower(digits)
    character(16), intent(in) :: digits
    integer :: k
    lower = digits
    do k = 1, 16
      if (digits(k:k) >= 'A') lower(k:k) = achar(iachar(digits(k:k)) + 32)
    end do
  end function

  ! lo, hi: (dims, 0 : parts - 1).
  subroutine regions(self, lo, hi, stat, errmsg)
    class(rcbd_cuts), intent(in) :: self
    real(real64), allocatable, intent(inout) :: lo(:, :), hi(:, :)
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(c_cuts_info) :: info
    call describe(self, info, stat, errmsg)
    if (allocated(lo)) deallocate (lo)
    if (allocated(hi)) deallocate (hi)
    allocate (lo(info%dims, 0:info%parts - 1), hi(info%dims, 0:info%parts - 1))
    if (info%parts == 0) return
    if (bad(c_cuts_regions(live(self), lo, hi), stat, errmsg)) return
  end subroutine

  ! Whether a distance, or a box, can't be one of these cuts.
  logical function not_near(self, near, c, dims, stat, errmsg)
    class(rcbd_cuts), intent(in) :: self
    type(rcbd_near), intent(in), target, optional :: near
    type(c_near), intent(out) :: c
    integer, intent(out) :: dims
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(c_cuts_info) :: info
    info%size = c_sizeof(info)
    c%size = c_sizeof(c)
    not_near = bad(c_cuts_describe(live(self), info), stat, errmsg)
    dims = info%dims
    if (not_near .or. .not. present(near)) return
    c%width = near%width
    c%norm = near%norm
    not_near = refused(allocated(near%lo) .neqv. allocated(near%hi), 'of lo and hi one is missing', stat, errmsg)
    if (not_near .or. .not. allocated(near%lo)) return
    not_near = refused(size(near%lo) /= dims .or. size(near%hi) /= dims, &
                       'lo and hi of the periodic box have other lengths than the cuts have dims', stat, errmsg)
    c%lo = c_loc(near%lo)
    c%hi = c_loc(near%hi)
  end function

  subroutine find_owner(self, rows, part, ids, ids4, options, stat, errmsg)
    class(rcbd_cuts), intent(in) :: self
    type(given), intent(inout), target :: rows
    integer(int32), allocatable, target, intent(inout) :: part(:)
    integer(int64), intent(in), target, optional :: ids(:)
    integer(int32), intent(in), optional :: ids4(:)
    type(rcbd_ask_options), intent(in), target, optional :: options
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(c_ask_options) :: c
    c%size = c_sizeof(c)
    c%ids = ids_of(rows, ids, ids4)
    call ask(rows, options, c)
    if (is_wrong(rows, stat, errmsg)) return
    if (allocated(part)) then
      if (size(part, kind=int64) /= rows%at%count) deallocate (part)
    end if
    if (.not. allocated(part)) allocate (part(rows%at%count))
    if (size(part, kind=int64) == 0) then
      if (bad(c_cuts_owner(live(self), rows%at, c, c_loc(nothing)), stat, errmsg)) return
    else
      if (bad(c_cuts_owner(live(self), rows%at, c, c_loc(part)), stat, errmsg)) return
    end if
  end subroutine

  subroutine ask(rows, options, c)
    type(given), intent(inout) :: rows
    type(rcbd_ask_options), intent(in), target, optional :: options
    type(c_ask_options), intent(inout) :: c
    if (.not. present(options)) return
    if (allocated(options%last_part)) then
      if (size(options%last_part, kind=int64) /= rows%at%count) rows%wrong = 'last_part has another length than there are rows'
      if (size(options%last_part, kind=int64) > 0) c%last_part = c_loc(options%last_part)
    end if
    if (allocated(options%widths)) then
      if (size(options%widths, kind=int64) /= rows%at%count) rows%wrong = 'widths has another length than there are rows'
      if (size(options%widths, kind=int64) > 0) c%widths = c_loc(options%widths)
    end if
    c%entries_max = options%entries_max
    c%seats = options%seats
    c%threads = options%threads
  end subroutine

  subroutine find_halo(self, rows, near, halo, ids, ids4, options, stat, errmsg)
    class(rcbd_cuts), intent(in) :: self
    type(given), intent(inout), target :: rows
    type(rcbd_near), intent(in), target :: near
    type(rcbd_halo), intent(inout) :: halo
    integer(int64), intent(in), target, optional :: ids(:)
    integer(int32), intent(in), optional :: ids4(:)
    type(rcbd_ask_options), intent(in), target, optional :: options
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(c_near) :: c_distance
    type(c_ask_options) :: c
    type(c_lists_view) :: view
    type(c_ptr) :: lists
    integer(int64), pointer :: offset(:)
    integer :: dims
    c%size = c_sizeof(c)
    c%ids = ids_of(rows, ids, ids4)
    call ask(rows, options, c)
    if (is_wrong(rows, stat, errmsg)) return
    if (not_near(self, near, c_distance, dims, stat, errmsg)) return
    if (bad(c_cuts_halo(live(self), rows%at, c_distance, c, lists), stat, errmsg)) return
    call read_lists(lists, view)
    if (allocated(halo%offset)) deallocate (halo%offset)
    allocate (halo%offset(0:view%lists))
    call c_f_pointer(view%offset, offset, [view%lists + 1])
    halo%offset(:) = offset
    call get_rows(view%item, view%entries, halo%row)
    call get_shifts(view, dims, halo%shift)
    call c_release(lists)
    if (c%seats > 0) call count_seats(self, rows, c, halo%of_seat, stat, errmsg)
  end subroutine

  ! Seat k of M has the parts k P / M to (k + 1) P / M - 1.
  subroutine count_seats(self, rows, c, of_seat, stat, errmsg)
    class(rcbd_cuts), intent(in) :: self
    type(given), intent(in) :: rows
    type(c_ask_options), intent(in) :: c
    integer(int64), allocatable, intent(inout) :: of_seat(:)
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    integer(int32), allocatable, target :: part(:)
    integer(int64) :: k, seat
    type(c_cuts_info) :: info
    type(c_ask_options) :: mine
    mine%size = c_sizeof(mine)
    mine%ids = c%ids
    mine%threads = c%threads
    if (allocated(of_seat)) deallocate (of_seat)
    allocate (of_seat(0:c%seats - 1), part(max(rows%at%count, 1_int64)))
    of_seat = 0
    call describe(self, info, stat, errmsg)
    if (bad(c_cuts_owner(live(self), rows%at, mine, c_loc(part)), stat, errmsg)) return
    do k = 1, rows%at%count
      seat = ((part(k) + 1_int64) * c%seats - 1) / info%parts
      of_seat(seat) = of_seat(seat) + 1
    end do
  end subroutine

  subroutine read_lists(lists, view)
    type(c_ptr), intent(in) :: lists
    type(c_lists_view), intent(inout) :: view
    view%size = c_sizeof(view)
    if (bad(c_lists_read(lists, view))) return
  end subroutine

  subroutine get_shifts(view, dims, shift)
    type(c_lists_view), intent(in) :: view
    integer, intent(in) :: dims
    integer(int32), allocatable, intent(inout) :: shift(:, :)
    integer(int32), pointer :: from(:, :)
    if (allocated(shift)) deallocate (shift)
    allocate (shift(dims, view%entries))
    shift = 0
    if (view%entries == 0 .or. .not. c_associated(view%shift)) return
    call c_f_pointer(view%shift, from, [int(dims, int64), view%entries])
    shift(:, :) = from
  end subroutine

  ! The parts of a list, and with what shifts(dims, :).
  subroutine get_parts(lists, dims, part, shift)
    type(c_ptr), intent(in) :: lists
    integer, intent(in) :: dims
    integer(int32), allocatable, intent(inout) :: part(:)
    integer(int32), allocatable, intent(inout), optional :: shift(:, :)
    type(c_lists_view) :: view
    integer(int64), pointer :: from(:)
    call read_lists(lists, view)
    if (allocated(part)) deallocate (part)
    allocate (part(view%entries))
    if (view%entries > 0) then
      call c_f_pointer(view%item, from, [view%entries])
      part(:) = int(from, int32)
    end if
    if (present(shift)) call get_shifts(view, dims, shift)
    call c_release(lists)
  end subroutine

  ! The parts within near%width of this part's region.
  subroutine neighbours(self, of_part, near, part, shift, stat, errmsg)
    class(rcbd_cuts), intent(in) :: self
    integer, intent(in) :: of_part
    type(rcbd_near), intent(in), target :: near
    integer(int32), allocatable, intent(inout) :: part(:)
    integer(int32), allocatable, intent(inout), optional :: shift(:, :)
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(c_near) :: c
    type(c_ptr) :: lists
    integer :: dims
    if (not_near(self, near, c, dims, stat, errmsg)) return
    if (bad(c_cuts_neighbours(live(self), int(of_part, c_int32_t), c, lists), stat, errmsg)) return
    call get_parts(lists, dims, part, shift)
  end subroutine

  ! The parts whose region touches the box, or one of its images where `near` has a periodic box.
  subroutine box(self, lo, hi, part, near, stat, errmsg)
    class(rcbd_cuts), intent(in) :: self
    real(real64), intent(in) :: lo(:), hi(:)
    integer(int32), allocatable, intent(inout) :: part(:)
    type(rcbd_near), intent(in), target, optional :: near
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(c_near) :: c
    type(c_ptr) :: lists
    integer :: dims
    if (not_near(self, near, c, dims, stat, errmsg)) return
    if (refused(size(lo) /= dims .or. size(hi) /= dims, &
                'lo and hi of the box have other lengths than the cuts have dims', stat, errmsg)) return
    if (bad(c_cuts_box(live(self), lo, hi, c, lists), stat, errmsg)) return
    call get_parts(lists, dims, part)
  end subroutine

  ! part is -1 where no region has two opposite faces; axes count from 1.
  subroutine narrowest(self, part, axis, width, near, stat, errmsg)
    class(rcbd_cuts), intent(in) :: self
    integer(int32), intent(out) :: part, axis
    real(real64), intent(out) :: width
    type(rcbd_near), intent(in), target, optional :: near
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(c_near) :: c
    integer :: dims
    part = -1
    axis = 0
    width = 0
    if (not_near(self, near, c, dims, stat, errmsg)) return
    if (bad(c_cuts_narrowest(live(self), c, part, axis, width), stat, errmsg)) return
    axis = axis + 1
  end subroutine

  subroutine owner_r8(self, x, part, ids, ids4, options, stat, errmsg)
    class(rcbd_cuts), intent(in) :: self
    real(real64), intent(in), target :: x(:, :)
    integer(int32), allocatable, intent(inout) :: part(:)
    integer(int64), intent(in), target, optional :: ids(:)
    integer(int32), intent(in), optional :: ids4(:)
    type(rcbd_ask_options), intent(in), optional :: options
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(given), target :: rows
    call take(rows, x)
    call find_owner(self, rows, part, ids, ids4, options, stat, errmsg)
  end subroutine

  subroutine owner_axes_r8(self, x, y, z, part, ids, ids4, options, stat, errmsg)
    class(rcbd_cuts), intent(in) :: self
    real(real64), intent(in), target :: x(:)
    real(real64), intent(in), target, optional :: y(:), z(:)
    integer(int32), allocatable, intent(inout) :: part(:)
    integer(int64), intent(in), target, optional :: ids(:)
    integer(int32), intent(in), optional :: ids4(:)
    type(rcbd_ask_options), intent(in), optional :: options
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(given), target :: rows
    call take(rows, x, y, z)
    call find_owner(self, rows, part, ids, ids4, options, stat, errmsg)
  end subroutine

  subroutine owner_r4(self, x, part, ids, ids4, options, stat, errmsg)
    class(rcbd_cuts), intent(in) :: self
    real(real32), intent(in), target :: x(:, :)
    integer(int32), allocatable, intent(inout) :: part(:)
    integer(int64), intent(in), target, optional :: ids(:)
    integer(int32), intent(in), optional :: ids4(:)
    type(rcbd_ask_options), intent(in), optional :: options
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(given), target :: rows
    call take(rows, x)
    call find_owner(self, rows, part, ids, ids4, options, stat, errmsg)
  end subroutine

  subroutine owner_axes_r4(self, x, y, z, part, ids, ids4, options, stat, errmsg)
    class(rcbd_cuts), intent(in) :: self
    real(real32), intent(in), target :: x(:)
    real(real32), intent(in), target, optional :: y(:), z(:)
    integer(int32), allocatable, intent(inout) :: part(:)
    integer(int64), intent(in), target, optional :: ids(:)
    integer(int32), intent(in), optional :: ids4(:)
    type(rcbd_ask_options), intent(in), optional :: options
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(given), target :: rows
    call take(rows, x, y, z)
    call find_owner(self, rows, part, ids, ids4, options, stat, errmsg)
  end subroutine

  subroutine halo_r8(self, x, near, halo, ids, ids4, options, stat, errmsg)
    class(rcbd_cuts), intent(in) :: self
    real(real64), intent(in), target :: x(:, :)
    type(rcbd_near), intent(in) :: near
    type(rcbd_halo), intent(inout) :: halo
    integer(int64), intent(in), target, optional :: ids(:)
    integer(int32), intent(in), optional :: ids4(:)
    type(rcbd_ask_options), intent(in), optional :: options
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(given), target :: rows
    call take(rows, x)
    call find_halo(self, rows, near, halo, ids, ids4, options, stat, errmsg)
  end subroutine

  subroutine halo_axes_r8(self, x, y, z, near, halo, ids, ids4, options, stat, errmsg)
    class(rcbd_cuts), intent(in) :: self
    real(real64), intent(in), target :: x(:)
    real(real64), intent(in), target, optional :: y(:), z(:)
    type(rcbd_near), intent(in) :: near
    type(rcbd_halo), intent(inout) :: halo
    integer(int64), intent(in), target, optional :: ids(:)
    integer(int32), intent(in), optional :: ids4(:)
    type(rcbd_ask_options), intent(in), optional :: options
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(given), target :: rows
    call take(rows, x, y, z)
    call find_halo(self, rows, near, halo, ids, ids4, options, stat, errmsg)
  end subroutine

  subroutine halo_r4(self, x, near, halo, ids, ids4, options, stat, errmsg)
    class(rcbd_cuts), intent(in) :: self
    real(real32), intent(in), target :: x(:, :)
    type(rcbd_near), intent(in) :: near
    type(rcbd_halo), intent(inout) :: halo
    integer(int64), intent(in), target, optional :: ids(:)
    integer(int32), intent(in), optional :: ids4(:)
    type(rcbd_ask_options), intent(in), optional :: options
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(given), target :: rows
    call take(rows, x)
    call find_halo(self, rows, near, halo, ids, ids4, options, stat, errmsg)
  end subroutine

  subroutine halo_axes_r4(self, x, y, z, near, halo, ids, ids4, options, stat, errmsg)
    class(rcbd_cuts), intent(in) :: self
    real(real32), intent(in), target :: x(:)
    real(real32), intent(in), target, optional :: y(:), z(:)
    type(rcbd_near), intent(in) :: near
    type(rcbd_halo), intent(inout) :: halo
    integer(int64), intent(in), target, optional :: ids(:)
    integer(int32), intent(in), optional :: ids4(:)
    type(rcbd_ask_options), intent(in), optional :: options
    integer, intent(out), optional :: stat
    character(*), intent(inout), optional :: errmsg
    type(given), target :: rows
    call take(rows, x, y, z)
    call find_halo(self, rows, near, halo, ids, ids4, options, stat, errmsg)
  end subroutine
end module
