! dem_fortran: soft spheres in a periodic box, on the processes of mpirun. A process computes the spheres of its own parts; of
! the others' it has copies of those that may touch them, the ghosts. At the start spheres fill half of the box, in two layers
! that flow past each other.
!
!   mpifort -O2 -ffp-contract=off rcbd.f90 rcbd_mpi.f90 dem.f90 -o dem_fortran -lrcbd
!
! All bits are the same with the same --parts (default: the number of processes), and as in dem.c: a contact is computed
! once, by the process that has the sphere of the lower id, by + - * / and sqrt alone, which must not be contracted, and
! forces are summed as integers.

! ---- the solver, which knows nothing of processes ----
module spheres
  use, intrinsic :: iso_fortran_env, only: int64, real64
  implicit none
  real(real64), parameter :: diameter = 1, stiffness = 1000, damping = 2, dt = 0.005_real64, unit = 4294967296.0_real64
  integer :: n = 0                                                 ! of mine; the ghosts' rows follow them
  real(real64), allocatable :: x(:, :), v(:, :), x0(:, :)          ! x0: where they were at the last push
  integer(int64), allocatable :: force(:, :), id(:)
  interface resize
    module procedure resize_vectors, resize_ids
  end interface
contains
  ! The spheres of these ids, on a lattice with so many sites along an axis.
  subroutine place(first, last, sites)
    integer(int64), intent(in) :: first, last, sites
    integer(int64) :: site(3), random
    real(real64) :: u(6)
    integer :: i, k
    n = int(last - first)
    allocate (x(3, n), v(3, n), id(n))
    do i = 1, n
      id(i) = first + i - 1
      site = [id(i) / (sites * sites), mod(id(i) / sites, sites), mod(id(i), sites)]
      random = mod((id(i) + 1) * 69621, 2147483647_int64)
      do k = -2, 6
        random = mod(random * 16807, 2147483647_int64)
        u(max(k, 1)) = real(random, real64) / 2147483647.0_real64  ! the first three are overwritten
      end do
      x(:, i) = 1.2_real64 * (real(site, real64) + (0.4_real64 + 0.2_real64 * u(:3)))
      v(:, i) = 2 * u(4:) - 1
      v(1, i) = v(1, i) + merge(1, -1, site(2) < sites / 2)
    end do
  end subroutine

  subroutine resize_vectors(a, rows)
    real(real64), allocatable, intent(inout) :: a(:, :)
    integer, intent(in) :: rows
    real(real64), allocatable :: b(:, :)
    allocate (b(3, rows))
    b(:, :min(rows, size(a, 2))) = a(:, :min(rows, size(a, 2)))
    call move_alloc(b, a)
  end subroutine

  subroutine resize_ids(a, rows)
    integer(int64), allocatable, intent(inout) :: a(:)
    integer, intent(in) :: rows
    integer(int64), allocatable :: b(:)
    allocate (b(rows))
    b(:min(rows, size(a))) = a(:min(rows, size(a)))
    call move_alloc(b, a)
  end subroutine

  ! The forces of i and j, whose id is the higher one.
  subroutine touch(i, j)
    integer, intent(in) :: i, j
    integer(int64) :: f(3)
    real(real64) :: d(3), q, r, closing, g
    d = x(:, j) - x(:, i)
    q = (d(1) * d(1) + d(2) * d(2)) + d(3) * d(3)
    if (q >= diameter * diameter .or. .not. q > 0) return
    r = sqrt(q)
    closing = ((v(1, i) - v(1, j)) * d(1) + (v(2, i) - v(2, j)) * d(2)) + (v(3, i) - v(3, j)) * d(3)
    g = (stiffness * (diameter - r) + damping * closing / r) / r
    f = floor(g * d * unit + 0.5_real64, int64)
    force(:, j) = force(:, j) + f
    force(:, i) = force(:, i) - f
  end subroutine

  ! Forces of all spheres and ghosts. What touches is in cells next to each other, as these are somewhat wider than a sphere.
  subroutine compute_forces()
    integer, allocatable :: head(:, :, :), next(:), cell(:, :)
    integer :: cells(3), i, j, a, b, c
    real(real64) :: lo(3)
    force = 0
    if (size(x, 2) == 0) return
    lo = minval(x, dim=2)
    cells = int((maxval(x, dim=2) - lo) / (1.01_real64 * diameter)) + 1
    allocate (head(0:cells(1) + 1, 0:cells(2) + 1, 0:cells(3) + 1), next(size(x, 2)), cell(3, size(x, 2)))
    head = 0
    do i = 1, size(x, 2)
      cell(:, i) = int((x(:, i) - lo) / (1.01_real64 * diameter)) + 1
      next(i) = head(cell(1, i), cell(2, i), cell(3, i))
      head(cell(1, i), cell(2, i), cell(3, i)) = i
    end do
    do i = 1, n
      do c = cell(3, i) - 1, cell(3, i) + 1
        do b = cell(2, i) - 1, cell(2, i) + 1
          do a = cell(1, i) - 1, cell(1, i) + 1
            j = head(a, b, c)
            do while (j > 0)
              if (id(i) < id(j)) call touch(i, j)
              j = next(j)
            end do
          end do
        end do
      end do
    end do
  end subroutine

  subroutine advance()
    v(:, :n) = v(:, :n) + dt * (real(force(:, :n), real64) / unit)
    x(:, :n) = x(:, :n) + dt * v(:, :n)
  end subroutine
end module

! ---- the coupling ----
program dem
  use, intrinsic :: iso_c_binding, only: c_int
  use, intrinsic :: iso_fortran_env, only: error_unit, int32, int64, output_unit, real64
  use mpi_f08
  use rcbd
  use rcbd_mpi
  use spheres
  implicit none
  interface
    subroutine c_exit(code) bind(c, name='exit')  ! `stop` would print
      import :: c_int
      integer(c_int), value :: code
    end subroutine
  end interface
  integer(int64) :: particles = 500, pushes = 50, push_every = 10, parts = 0, sites = 4, k
  real(real64) :: reach = 0, side
  character(1024) :: scene_name = 'spheres', endpoint = '', trajectory = '', why
  character(16) :: positions = 'every-step', digits
  type(MPI_Comm) :: comm
  integer :: rank, processes, repartitioned = 0, stat, file = 0
  type(rcbd_client) :: client
  type(rcbd_scene) :: scene
  type(rcbd_step) :: step
  type(rcbd_cuts) :: cuts
  type(rcbd_near) :: near
  type(rcbd_mpi_halo) :: halo

  call read_options()
  call MPI_Init()
  call MPI_Comm_dup(MPI_COMM_WORLD, comm)
  call MPI_Comm_rank(comm, rank)
  call MPI_Comm_size(comm, processes)
  do while (sites**3 < 2 * particles)
    sites = sites + 1
  end do
  side = 1.2_real64 * real(sites, real64)
  ! A sphere of another process and one of mine may both move by the reach until the next push, towards each other. The
  ! millionth more is for what is lost in rounding.
  near = rcbd_near(width=1.000001_real64 * (diameter + 2 * reach), lo=[0, 0, 0] * side, hi=[1, 1, 1] * side)
  if (.not. 2 * near%width < side) call end('the halo is as wide as half of the box, so a sphere could meet two images of ' // &
    'another; take a smaller --reach or --push-every, or more --particles')
  if (parts == 0) parts = processes
  call rcbd_mpi_connect(comm, client, endpoint, stat=stat, errmsg=why)
  call all_must()
  call rcbd_mpi_scene_open(comm, scene, client, scene_name, &
    rcbd_scene_options(parts=int(parts), tolerance=0.05_real64, positions=positions, replace=.true.), stat, why)
  call all_must()
  call open_trajectory()
  call place(particles * rank / processes, particles * (rank + 1) / processes, sites)
  do k = 0, pushes - 1
    call push()
    call write_trajectory()
    call make_halo()
    call move_until_next_push()
    call resize(x, n)  ! the ghosts go
    call resize(v, n)
    call resize(id, n)
  end do
  if (rank == 0) then
    digits = cuts%hex_hash()
    print '(a, i0)', 'pushes ', pushes, 'repartitioned ', repartitioned
    print '(2a)', 'cuts ', digits
  end if
  call cuts%release()
  call scene%release()
  call client%release()
  call MPI_Finalize()
contains
  ! Pushes my spheres and hands over those that leave.
  subroutine push()
    type(rcbd_mpi_moves) :: moves
    call rcbd_wrap(x, near%lo, near%hi, stat, why)
    call all_must()
    call rcbd_mpi_step(comm, scene, x, step, ids=id, stat=stat, errmsg=why)
    call all_must()
    call moves%make(comm, step, n, stat, why)
    call all_must()
    call moves%move(id)
    call moves%move(x)
    call moves%move(v)
    n = int(moves%rows)
    x0 = x
    if (step%report%repartitioned) repartitioned = repartitioned + 1
  end subroutine

  ! The halo until the next push.
  subroutine make_halo()
    type(rcbd_halo) :: lists
    call scene%cuts(cuts, stat, why)
    if (stat == rcbd_ok) call cuts%halo(x, near, lists, ids=id, options=rcbd_ask_options(seats=processes), stat=stat, errmsg=why)
    call all_must()
    call halo%make(comm, lists, near, n, stat, why)
    call all_must()
    call resize(x, n + int(halo%ghosts))
    call resize(v, n + int(halo%ghosts))
    call resize(id, n + int(halo%ghosts))
    if (allocated(force)) deallocate (force)
    allocate (force(3, n + int(halo%ghosts)))
    call halo%forward(id)
  end subroutine

  subroutine move_until_next_push()
    integer(int64) :: time_step
    do time_step = 1, push_every
      if (time_step > 1) call check_reach()
      call halo%forward_positions(x, v)
      call compute_forces()
      call halo%reverse_add(force)
      call advance()
    end do
  end subroutine

  subroutine check_reach()
    integer(int64) :: far(1)
    integer :: i
    far = huge(far)
    do i = 1, n
      if (.not. all(abs(x(:, i) - x0(:, i)) <= reach)) far = min(far, id(i))
    end do
    call MPI_Allreduce(MPI_IN_PLACE, far, 1_int32, MPI_INTEGER8, MPI_MIN, comm)
    if (far(1) == huge(far)) return
    write (why, '(a, i0, a, f0.6, 2a)') 'sphere ', far, ' has moved by more than ', reach, ' since the last push, so the halo ', &
      'may lack spheres that it touches; push more often (--push-every), or give a greater --reach'
    call end(why)
  end subroutine

  ! ---- failures ----

  ! Of all processes: where one has failed (stat), all end.
  subroutine all_must()
    call rcbd_mpi_agree(comm, stat, why)
    if (stat /= rcbd_ok) call end(why)
  end subroutine

  ! Of all processes together.
  subroutine end(message)
    character(*), intent(in) :: message
    if (rank == 0) write (error_unit, '(2a)') 'dem_fortran: ', trim(message)
    call MPI_Finalize()
    call c_exit(1_c_int)
  end subroutine

  ! ---- the trajectory: real64, (3, particles, pushes) ----

  subroutine written()
    why = 'the trajectory can''t be written; ' // trim(trajectory)
    if (stat /= 0) stat = rcbd_io_error
    call all_must()
  end subroutine

  subroutine open_trajectory()
    if (trajectory == '') return
    stat = 0
    if (rank == 0) open (newunit=file, file=trajectory, access='stream', status='replace', action='write', iostat=stat)
    if (rank == 0 .and. stat == 0) close (file, iostat=stat)
    call written()  ! and only then do the others open it
    open (newunit=file, file=trajectory, access='stream', status='old', action='readwrite', iostat=stat)
    call written()
  end subroutine

  subroutine write_trajectory()
    integer :: i
    if (trajectory == '') return
    stat = 0
    do i = 1, n
      if (stat == 0) write (file, pos=24 * (k * particles + id(i)) + 1, iostat=stat) x(:, i)
    end do
    if (stat == 0) flush (file, iostat=stat)
    call written()
  end subroutine

  ! ---- options ----

  subroutine usage(to, code)
    integer, intent(in) :: to
    integer(c_int), intent(in) :: code
    write (to, '(a)') 'dem_fortran: soft spheres in a periodic box, on the processes of mpirun', &
      '    [--particles N] [--pushes N] [--push-every TIME_STEPS] [--parts N] [--reach R] [--when-needed]', &
      '    [--scene NAME] [--endpoint E] [--trajectory FILE] [--help]'
    call c_exit(code)
  end subroutine

  subroutine read_options()
    character(1024) :: name, value
    real(real64) :: number
    integer :: at, wrong
    at = 0
    do while (at < command_argument_count())
      at = at + 1
      call get_command_argument(at, name)
      if (name == '--help') call usage(output_unit, 0_c_int)
      if (name == '--when-needed') then
        positions = 'when-needed'
        cycle
      end if
      at = at + 1
      value = ''
      if (at <= command_argument_count()) call get_command_argument(at, value)
      wrong = merge(0, 1, verify(trim(value), '0123456789.+-eE') == 0)
      number = -1
      if (wrong == 0) read (value, *, iostat=wrong) number
      if (.not. (number >= 0 .and. number < 1e9_real64)) wrong = 1
      select case (name)
      case ('--reach')
        reach = number
        if (.not. reach > 0) wrong = 1
      case ('--particles', '--pushes', '--push-every', '--parts')
        if (abs(number - anint(number)) > 0 .or. (name /= '--parts' .and. number < 1)) wrong = 1
        if (name == '--particles') particles = int(number, int64)
        if (name == '--pushes') pushes = int(number, int64)
        if (name == '--push-every') push_every = int(number, int64)
        if (name == '--parts') parts = int(number, int64)
      case ('--scene', '--endpoint', '--trajectory')
        wrong = merge(1, 0, value == '')
        if (name == '--scene') scene_name = value
        if (name == '--endpoint') endpoint = value
        if (name == '--trajectory') trajectory = value
      case default
        wrong = 1
      end select
      if (wrong /= 0) then
        write (error_unit, '(3a)') 'dem_fortran: ', trim(name), ': a wrong option or value'
        call usage(error_unit, 2_c_int)
      end if
    end do
    if (.not. reach > 0) reach = 6 * dt * real(push_every, real64)  ! the fastest begin with 2 along an axis
  end subroutine
end program
