! What module rcbd_mpi does, against brute force: mpirun -n P fortran_mpi ENDPOINT CASE. All processes know all particles, so
! each can say by itself which rows and ghosts it must have.
program mpi
  use mpi_f08
  use expect
  use rcbd_mpi
  implicit none
  real(real64), parameter :: side = 1
  type(MPI_Comm) :: comm
  integer(int32) :: rank, processes
  type(rcbd_client) :: client
  type(rcbd_scene) :: scene
  type(rcbd_step) :: step
  type(rcbd_cuts) :: cuts
  type(rcbd_near) :: near
  type(rcbd_mpi_moves) :: moves
  type(rcbd_mpi_halo) :: halo
  integer(int64), allocatable :: id(:)  ! of my rows: particle i has the id i - 1
  character(20) :: name
  real(real64), allocatable :: lo(:, :), hi(:, :)
  integer :: k
  name = asked_for(['moves ', 'ghosts', 'wrong ', 'others', 'agreed', 'steps '])
  if (name == '') stop
  call MPI_Init()
  comm = MPI_COMM_WORLD
  call MPI_Comm_rank(comm, rank)
  call MPI_Comm_size(comm, processes)
  x = mod(abs(x), side)
  near = rcbd_near(width=0.06_real64, lo=[0, 0, 0] * side, hi=[1, 1, 1] * side)
  id = [(int(k, int64), k = 0, n - 1)]
  if (processes > 1) id = pack(id, merge(0, 1, rank == 0) * (1 + mod(id, processes - 1_int64)) == rank .and. rank > 0)  ! 0 has none
  if (name /= 'agreed') then
    call rcbd_mpi_connect(comm, client, endpoint)
    call rcbd_mpi_scene_open(comm, scene, client, name, rcbd_scene_options(parts=2 * processes, replace=.true.))
  end if
  select case (name)
  case ('moves')
    do k = 1, 5
      call push()
      x(:, :n / 2) = x(:, :n / 2) * 0.8_real64
    end do
  case ('ghosts')
    do k = 1, 3
      call push()
      call ghosts()
      x(:, :n / 2) = mod(x(:, :n / 2) + 0.3_real64, side)
    end do
  case ('wrong')
    call push()
    call wrong()
  case ('others')
    call push()
    call others()
  case ('steps')
    call steps()
  case ('agreed')
    call agreed()
  end select
  call scene%release()
  call client%release()
  call MPI_Finalize()
contains
  ! Steps, and hands over arrays of each kind and rank.
  subroutine push()
    integer(int64), allocatable :: before(:), i8(:, :)
    integer(int32), allocatable :: i4(:), i42(:, :)
    real(real32), allocatable :: r4(:), r42(:, :)
    real(real64), allocatable :: r8(:), r82(:, :)
    integer(int32), allocatable :: part(:)
    integer :: stays, i, last(1)
    before = id
    i4 = int(id, int32)
    r4 = real(id, real32)
    r8 = real(id, real64)
    allocate (i42(3, size(id)), i8(1, size(id)), r42(5, size(id)))
    i42(3, :) = i4
    i8(1, :) = -id
    r42(5, :) = r4
    r82 = x(:, id + 1)
    call rcbd_mpi_step(comm, scene, r82, step, ids=id)
    call moves%make(comm, step, size(id))
    call moves%move(id)
    call moves%move(i4)
    call moves%move(i42)
    call moves%move(i8)
    call moves%move(r4)
    call moves%move(r42)
    call moves%move(r8)
    call moves%move(r82)
    call check(size(id) == moves%rows .and. size(r82, 2) == moves%rows .and. size(i42, 1) == 3, 'shapes')
    call check(all(i4 == id) .and. all(i42(3, :) == i4) .and. all(i8(1, :) == -id), 'integers')
    call check(all(r4 == i4) .and. all(r42(5, :) == i4) .and. all(r8 == i4) .and. all(r82 == x(:, id + 1)), 'reals')
    call scene%cuts(cuts)
    call cuts%owner(x, part)
    call check(size(id) == count((part + 1) * processes - 1 >= rank * cuts%parts() .and. &
                                 (part + 1) * processes - 1 < (rank + 1) * cuts%parts()), 'as many rows as are mine')
    call check(all(((part(id + 1) + 1) * processes - 1) / cuts%parts() == rank), 'they are mine')
    stays = count(((part(before + 1) + 1) * processes - 1) / cuts%parts() == rank)
    call check(all(id(:stays) == pack(before, ((part(before + 1) + 1) * processes - 1) / cuts%parts() == rank)), 'order')
    last = 0
    do i = 1, size(id)
      last(1) = last(1) + int(id(i), int32)
    end do
    call MPI_Allreduce(MPI_IN_PLACE, last, 1_int32, MPI_INTEGER4, MPI_SUM, comm)
    call check(last(1) == n * (n - 1) / 2, 'none is lost')
  end subroutine

  subroutine make_plan()
    type(rcbd_halo) :: lists
    call cuts%halo(x(:, id + 1), near, lists, ids=id, options=rcbd_ask_options(seats=processes))
    call halo%make(comm, lists, near, size(id))
    call check(halo%rows == size(id), 'rows')
  end subroutine

  ! Whether an image is near the region of a part of mine.
  logical function is_near(image)
    real(real64), intent(in) :: image(3)
    integer :: p
    is_near = .false.
    do p = 0, size(lo, 2) - 1
      if (((p + 1) * processes - 1) / size(lo, 2) /= rank) cycle
      if (maxval(max(lo(:, p) - image, image - hi(:, p))) <= near%width) is_near = .true.
    end do
  end function

  ! The images that are, but for my own particles where they are.
  integer function needed()
    integer :: i, a, b, c
    integer(int32), allocatable :: part(:)
    call cuts%owner(x, part)
    needed = 0
    do i = 1, n
      do a = -1, 1
        do b = -1, 1
          do c = -1, 1
            if (((part(i) + 1) * processes - 1) / size(lo, 2) == rank .and. all([a, b, c] == 0)) cycle
            if (is_near(x(:, i) + [a, b, c] * side)) needed = needed + 1
          end do
        end do
      end do
    end do
  end function

  subroutine ghosts()
    integer(int64), allocatable :: all_ids(:), i8(:, :)
    integer(int32), allocatable :: i4(:), i42(:, :)
    real(real32), allocatable :: r4(:), r42(:, :)
    real(real64), allocatable :: r8(:), at(:, :), velocity(:, :), axis(:, :)
    integer(int64), allocatable :: times(:)
    real(real64) :: shift(3)
    integer :: rows, total, i, j
    call make_plan()
    call cuts%regions(lo, hi)
    lo = max(lo, 0._real64)
    hi = min(hi, side)
    rows = size(id)
    total = rows + int(halo%ghosts)
    call check(halo%ghosts == needed(), 'as many ghosts as brute force finds')
    allocate (all_ids(total), at(3, total), velocity(3, total), axis(total, 3), r42(3, total))
    all_ids = -1
    all_ids(:rows) = id
    call halo%forward(all_ids)
    call check(all(all_ids >= 0 .and. all_ids < n), 'ids of ghosts')
    at = 0
    at(:, :rows) = x(:, id + 1)
    velocity = 0
    velocity(:, :rows) = -at(:, :rows)
    r42 = real(at, real32)
    axis(:rows, :) = transpose(at(:, :rows))
    call halo%forward_positions(at, velocity)
    call halo%forward_positions(axis(:, 1), axis(:, 2), axis(:, 3))
    call halo%forward_positions(r42)
    do i = rows + 1, total
      shift = anint((at(:, i) - x(:, all_ids(i) + 1)) / side)
      do j = 1, 3
        if (abs(shift(j)) > 0) shift(j) = x(j, all_ids(i) + 1) + shift(j) * side
        if (.not. abs(shift(j)) > 0) shift(j) = x(j, all_ids(i) + 1)
      end do
      call check(all(at(:, i) == shift) .and. all(axis(i, :) == shift), 'positions of ghosts')
      call check(is_near(at(:, i)), 'ghosts are near')
      call check(all(velocity(:, i) == -x(:, all_ids(i) + 1)), 'velocities of ghosts')
      call check(all(abs(r42(:, i) - at(:, i)) < 1e-6), 'in single precision')
      do j = i + 1, total
        call check(any(at(:, i) /= at(:, j)) .or. all_ids(i) /= all_ids(j), 'each once')
      end do
    end do
    ! Each owner's row gets what its ghosts have: 1, and the row's own number of ghosts.
    i8 = reshape([(1_int64, i = 1, 2 * total)], [2, total])
    call halo%reverse_add(i8)
    allocate (times(rows))
    times = i8(2, :rows)
    call check(all(i8(:, rows + 1:) == 1) .and. all(i8(1, :rows) == times), 'ghosts stay as they are')
    call sum_to(int(sum(times - 1)), int(halo%ghosts))
    i4 = int(all_ids, int32)
    i42 = spread(i4, 1, 2)
    r4 = real(all_ids, real32)
    r8 = real(all_ids, real64)
    r42 = spread(r4, 1, 3)
    velocity = spread(r8, 1, 3)
    call halo%reverse_add(all_ids)
    call halo%reverse_add(i4)
    call halo%reverse_add(i42)
    call halo%reverse_add(r4)
    call halo%reverse_add(r8)
    call halo%reverse_add(r42)
    call halo%reverse_add(velocity)
    call check(all(all_ids(:rows) == id * times), 'sums')
    call check(all(i4(:rows) == id * times) .and. all(i42(2, :rows) == id * times), 'of integers')
    call check(all(r4(:rows) == id * times) .and. all(r42(3, :rows) == id * times), 'of single precision')
    call check(all(r8(:rows) == id * times) .and. all(velocity(3, :rows) == id * times), 'of reals')
    call halo%forward(r4)
    call halo%forward(i4)
    call halo%forward(r8, r8)
    call halo%forward(i42, i42)
    call halo%forward(r42)
    call halo%forward(i8)
    call check(all(i8(1, rows + 1:) == i8(2, rows + 1:)) .and. all(r4 == i4) .and. all(i42(2, :) == r8), 'forward, of all kinds')
  end subroutine

  ! That all numbers together are all others together.
  subroutine sum_to(one, other)
    integer, intent(in) :: one, other
    integer(int32) :: sums(2)
    sums = [one, other]
    call MPI_Allreduce(MPI_IN_PLACE, sums, 2_int32, MPI_INTEGER4, MPI_SUM, comm)
    call check(sums(1) == sums(2), 'sums over all processes')
  end subroutine

  subroutine wrong()
    type(rcbd_mpi_moves) :: no_moves
    type(rcbd_mpi_halo) :: no_halo
    type(rcbd_halo) :: lists
    type(rcbd_step) :: no_step
    real(real64), allocatable :: a(:, :)
    integer(int64), allocatable :: none(:)
    allocate (none(0), a(2, size(id)))
    call no_moves%move(none, stat, why)
    call failed(rcbd_invalid_argument, 'make()')
    call no_halo%forward(none, stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, 'make()')
    call no_halo%reverse_add(none, stat, why)
    call failed(rcbd_invalid_argument, 'make()')
    call moves%move(a, stat, why)
    if (moves%before /= moves%rows) call failed(rcbd_invalid_argument, 'should be')
    call no_moves%make(comm, no_step, 5, stat, why)
    call failed(rcbd_invalid_argument, 'process 0: the step wasn''t made')
    call halo%make(comm, lists, near, size(id), stat, why)
    call failed(rcbd_invalid_argument, 'process 0: the halo''s lists')
    call cuts%halo(x(:, id + 1), near, lists, ids=id)  ! by parts, of which there are twice as many
    call halo%make(comm, lists, near, size(id), stat, why)
    call failed(rcbd_invalid_argument, 'seats')
    call make_plan()
    call halo%forward(id, stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, 'should be')
    call halo%forward_positions(a, stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, 'dims')
    call halo%reverse_add(a(:, 1:0), stat, why)
    call failed(rcbd_invalid_argument, 'should be')
    call no_moves%make(comm, step, merge(0, size(id), rank == processes - 1), stat, why)  ! one process has other rows
    if (stat /= rcbd_ok) call failed(rcbd_invalid_argument, 'process')
  end subroutine

  ! Plans of rows that weren't handed over, or with another distance, and arrays that differ from process to process.
  subroutine others()
    type(rcbd_halo) :: lists
    type(rcbd_near) :: no_box
    real(real64), allocatable :: a(:, :)
    integer(int64), allocatable :: few(:)
    integer :: i
    few = [(int(i, int64), i = rank, n - 1, processes)]
    call cuts%halo(x(:, few + 1), near, lists, ids=few, options=rcbd_ask_options(seats=processes))
    call halo%make(comm, lists, near, size(few), stat, why)
    if (processes > 1) call failed(rcbd_invalid_argument, 'rows belong to other processes')
    call make_plan()
    call cuts%halo(x(:, id + 1), near, lists, ids=id, options=rcbd_ask_options(seats=processes))
    no_box = rcbd_near(width=near%width)
    call halo%make(comm, lists, no_box, size(id), stat, why)
    call failed(rcbd_invalid_argument, 'periodic box')
    call halo%make(comm, lists, near, size(id) - 1, stat, why)
    call failed(rcbd_invalid_argument, 'other rows')
    ! The last process sends one row to process 0, of an array that has fewer columns than process 0's.
    lists%offset(:) = merge(1, 0, rank == processes - 1)
    lists%offset(0) = 0
    lists%row = lists%row(:lists%offset(processes))
    lists%shift = 0 * lists%shift(:, :lists%offset(processes))
    call halo%make(comm, lists, near, size(id), stat, why)
    call check(stat == rcbd_ok, 'a plan of one row')
    allocate (a(merge(1, 2, rank == processes - 1), halo%rows + halo%ghosts))
    a = 7
    call halo%forward(a, stat=stat, errmsg=why)
    if (rank == 0 .and. processes > 1) call failed(rcbd_invalid_argument, 'has sent other arrays')
    call check(stat == rcbd_ok, 'all others have what they expect')
  end subroutine

  ! A step that fails on the last process fails on all, with its words and not those of them who waited for it.
  subroutine steps()
    real(real32) :: axis(5)
    integer(int32) :: ids(5)
    axis = 0.5
    ids = [(int(5 * rank + k, int32), k = 1, 5)]
    call rcbd_mpi_step(comm, scene, axis, axis, axis, ids4=ids, stat=stat, errmsg=why)
    call check(stat == rcbd_ok, 'a step of single precision, by axis')
    call rcbd_mpi_step(comm, scene, axis(:merge(4, 5, rank == processes - 1)), axis, axis, ids4=ids, stat=stat, errmsg=why, &
                       options=rcbd_step_options(deadline_seconds=1))
    write (name, '(a, i0)') 'process ', processes - 1
    call failed(rcbd_invalid_argument, trim(name) // ': ids has another length')
    call rcbd_mpi_agree(comm, stat, why)
    call check(stat == rcbd_ok, 'no failure')
    stat = rcbd_io_error
    why = 'no disk'
    call rcbd_mpi_agree(comm, stat, why)
    call rcbd_mpi_agree(comm, stat, why)
    call check(why == 'process 0: no disk', 'agreed on twice, the process is named once')
    call rcbd_mpi_connect(comm, client, 'unix:/nonexistent/rcbd.sock', stat=stat, errmsg=why)
    call failed(rcbd_unavailable, 'process 0: ')
  end subroutine

  ! What fails on the last process fails on all, in its words.
  subroutine agreed()
    stat = rcbd_ok
    call rcbd_mpi_agree(comm, stat, why)
    call check(stat == rcbd_ok, 'nobody has failed')
    stat = merge(rcbd_io_error, rcbd_ok, rank == processes - 1)
    why = 'no disk'
    call rcbd_mpi_agree(comm, stat, why)
    write (name, '(a, i0)') 'process ', processes - 1
    call failed(rcbd_io_error, trim(name) // ': no disk')
    if (rank /= processes - 1) call connect(client)
    call rcbd_mpi_scene_open(comm, scene, client, 'agreed', rcbd_scene_options(parts=4, replace=.true.), stat, why)
    call failed(rcbd_invalid_argument, trim(name))
    if (rank == processes - 1) call connect(client)
    call rcbd_mpi_scene_open(comm, scene, client, 'agreed', rcbd_scene_options(parts=4, replace=.true.), stat, why)
    call check(stat == rcbd_ok, 'the scene is free again')
  end subroutine
end program
