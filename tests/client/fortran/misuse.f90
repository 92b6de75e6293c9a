! What a Fortran program may do wrong: each case is a message in words.
program misuse
  use expect
  implicit none
  select case (asked_for(['nulls   ', 'shapes  ', 'sections', 'finite  ', 'going_on', 'closed  ', 'boxes   ']))
  case ('nulls')
    call nulls()
  case ('shapes')
    call shapes()
  case ('sections')
    call sections()
  case ('finite')
    call finite()
  case ('going_on')
    call going_on()
  case ('closed')
    call closed()
  case ('boxes')
    call boxes()
  case ('ends')  ! these two end the program, as the test wants to see
    call ends()
  case ('assigned')
    call assigned()
  end select
contains
  ! Handles that hold nothing, and of another kind.
  subroutine nulls()
    type(rcbd_client) :: client
    type(rcbd_scene) :: scene
    type(rcbd_step) :: step
    type(rcbd_op) :: op
    type(rcbd_cuts) :: cuts
    type(rcbd_memory) :: memory
    type(rcbd_halo) :: halo
    real(real64), pointer :: at(:, :)
    real(real64), allocatable :: lo(:, :), hi(:, :)
    integer(int32), allocatable :: part(:)
    character(:), allocatable :: text
    integer(int32) :: p, axis
    real(real64) :: width
    logical :: done
    call client%connect('unix:/nonexistent/rcbd.sock', stat=stat, errmsg=why)
    call failed(rcbd_unavailable, 'no service answers')
    call client%connect(endpoint // achar(10), stat=stat, errmsg=why)
    call check(stat /= 0, 'an endpoint with a line feed')
    call scene%open(client, 'nulls', stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, 'client')
    call scene%step(x, step, stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, 'scene')
    call scene%step_begin(x, op, stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, 'scene')
    call op%wait(step, 0.1_real64, done, stat, why)
    call failed(rcbd_invalid_argument, 'op')
    call op%cancel()
    call client%interrupt()
    call check(.not. client%notice(text) .and. text == '', 'a notice of nobody')
    call check(scene%last_step(stat, why) == -1, 'a last step of nothing')
    call failed(rcbd_invalid_argument, 'scene')
    call scene%cuts(cuts, stat, why)
    call failed(rcbd_invalid_argument, 'scene')
    call scene%positions(5, at, memory, stat, why)
    call failed(rcbd_invalid_argument, 'scene')
    call check(.not. associated(at), 'an array of nothing')
    call check(cuts%parts(stat, why) == 0, 'parts of nothing')
    call failed(rcbd_invalid_argument, 'cuts')
    call check(cuts%hex_hash(stat, why) == '0000000000000000', 'the hash of nothing')
    call cuts%regions(lo, hi, stat, why)
    call failed(rcbd_invalid_argument, 'cuts')
    call cuts%owner(x, part, stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, 'cuts')
    call cuts%halo(x, rcbd_near(), halo, stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, 'cuts')
    call cuts%neighbours(0, rcbd_near(), part, stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, 'cuts')
    call cuts%box(x(:, 1), x(:, 2), part, stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, 'cuts')
    call cuts%narrowest(p, axis, width, stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, 'cuts')
    call scene%close(stat, why)
    call failed(rcbd_invalid_argument, 'handle')
    call cuts%release()
    call cuts%release()
    call connect(client)
    call client%drop('nulls', stat, why)
    call failed(rcbd_not_found, 'nulls')
    call scene%open(client, '', stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, 'name')
  end subroutine

  subroutine shapes()
    type(rcbd_scene) :: scene
    type(rcbd_client) :: client
    type(rcbd_step) :: step
    type(rcbd_op) :: op
    type(rcbd_cuts) :: cuts
    type(rcbd_halo) :: halo
    integer(int32), allocatable :: part(:)
    integer(int64) :: ids(n) = 0
    real(real64), pointer :: at(:, :)
    type(rcbd_memory) :: memory
    type(rcbd_step_options) :: options
    call open_new(scene, 'shapes')
    call scene%step(x(:2, :), stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, '2 dimensions')
    call scene%step(transpose(x), stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, 'x(dims, n)')
    call scene%step(x(1:0, :), stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, 'x(dims, n)')
    call scene%step(x(1, :), x(2, :), x(3, 2:), stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, 'differ in length')
    call scene%step(x(1, :), z=x(3, :), stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, 'no y')
    call scene%step(x, ids=ids(2:), stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, 'ids')
    call scene%step(x, ids4=int(ids(2:), int32), stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, 'ids')
    call scene%step(x, ids=ids, ids4=int(ids, int32), stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, 'both')
    call scene%step(x, ids=ids, stat=stat, errmsg=why)
    call failed(rcbd_duplicate_id, '')
    call scene%step(x, weights=x(1, 2:), stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, 'weights')
    call scene%step_begin(x(:, n:1:-1), op, stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, 'step_begin')
    call scene%step_begin(x, op, weights=x(1, :), stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, 'step_begin')
    call scene%step(x, step, stat=stat, errmsg=why)
    call check(stat == rcbd_ok .and. step%report%n == n .and. .not. allocated(step%part), 'a step')
    options%inserted = -1
    call scene%step(x, options=options, stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, 'inserted')
    options = rcbd_step_options(deadline_seconds=nan())
    call scene%step(x, options=options, stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, 'deadline')
    call scene%positions(-1, at, memory, stat, why)
    call failed(rcbd_invalid_argument, '')
    call scene%cuts(cuts)
    call cuts%owner(x(:2, :), part, stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, 'dimensions')
    call cuts%owner(x, part, options=rcbd_ask_options(last_part=[1, 2]), stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, 'last_part')
    call cuts%halo(x, rcbd_near(width=0.1_real64), halo, options=rcbd_ask_options(widths=[1._real64]), stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, 'widths')
    call cuts%halo(x, rcbd_near(width=0.1_real64), halo, ids=ids(2:), stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, 'ids')
    call cuts%halo(x, rcbd_near(width=0.5_real64), halo, options=rcbd_ask_options(entries_max=5), stat=stat, errmsg=why)
    call failed(rcbd_too_large, '')
    call connect(client)
    call scene%open(client, 'shapes', rcbd_scene_options(parts=3, part_sizes=[1._real64]), stat, why)
    call failed(rcbd_invalid_argument, 'part_sizes')
    call scene%open(client, 'shapes', rcbd_scene_options(parts=8, method='sausage', replace=.true.), stat, why)
    call failed(rcbd_invalid_argument, 'sausage')
  end subroutine

  ! Of whatever sections: the same as of whole arrays.
  subroutine sections()
    type :: atom
      integer(int32) :: kind
      real(real64) :: r(3)
      integer(int32) :: id
      integer(int64) :: long
      real(real32) :: r4(3)
    end type
    type(atom), allocatable :: atoms(:)
    type(rcbd_scene) :: scene
    type(rcbd_step) :: step
    type(rcbd_cuts) :: cuts
    type(rcbd_step_options) :: options
    integer(int32), allocatable :: part(:), expected(:), other(:)
    real(real32) :: x4(3, n)
    integer(int64) :: ids(n)
    integer :: i
    call open_new(scene, 'sections')
    options%want_parts = .true.
    do i = 1, n  ! on a grid, so that ids decide
      x(:, i) = real(int(x(:, i) * 8), real64) / 8
      ids(i) = mod(i * 7, n + 1)
    end do
    x4 = real(x, real32)
    allocate (atoms(n))
    do i = 1, n
      atoms(i) = atom(i, x(:, i), int(ids(i), int32), ids(i), x4(:, i))
    end do
    call scene%step(x, step, ids, options=options)
    expected = step%part
    call scene%step(atoms%r(1), atoms%r(2), atoms%r(3), step, ids4=atoms%id, options=options)
    call check(all(step%part == expected), 'axes that are components')
    call scene%step(atoms%r4(1), atoms%r4(2), atoms%r4(3), step, atoms%long, options=options)
    call check(all(step%part == expected), 'single precision, and ids that are components')
    call scene%step(x4, step, ids, options=options)
    call check(all(step%part == expected), 'single precision')
    call scene%step(x(:, n:1:-1), step, ids(n:1:-1), options=options)
    call check(all(step%part == expected(n:1:-1)), 'from the last to the first')
    call scene%step(x(1, n:1:-1), x(2, n:1:-1), x(3, n:1:-1), step, ids(n:1:-1), options=options)
    call check(all(step%part == expected(n:1:-1)), 'axes from the last to the first')
    call scene%cuts(cuts)
    call cuts%owner(x(:, ::3), part, ids(::3))
    call check(all(part == expected(::3)), 'each third row')
    call cuts%owner(x4(1, ::3), x4(2, ::3), x4(3, ::3), part, ids4=int(ids(::3), int32))
    call check(all(part == expected(::3)), 'each third row of axes')
    call cuts%owner(x(:, [3, 1, 2]), part, ids([3, 1, 2]), options=rcbd_ask_options(last_part=expected([3, 1, 2])))
    call check(all(part == expected([3, 1, 2])), 'rows by number')
    call cuts%owner(x(1, :), x4(2, :) * 1._real64, atoms%r(3), part, ids)
    call check(all(part == expected), 'axes of different steps')
    call cuts%owner(x(:, 1:0), part, ids(1:0))
    call check(size(part) == 0, 'no rows')
    call cuts%owner(x(:, 5:5), other)
    call check(size(other) == 1, 'one row')
    x(1, :) = x(1, :) + 3
    call rcbd_wrap(x(:, n:1:-1), [0._real64, 0._real64, 0._real64], [1._real64, 1._real64, 1._real64])
    call rcbd_wrap(atoms%r4(1), y=atoms%r4(2), lo=[0.25_real64, 0._real64], hi=[0.5_real64, 1._real64])
    call check(all(x >= 0 .and. x < 1) .and. all(atoms%r4(1) >= 0.25 .and. atoms%r4(1) < 0.5), 'wrapped sections')
    call check(all(abs(x(1, :) - atoms%r(1)) < 1e-12_real64), 'by whole periods')
    call scene%step(x(:, 1:0), step, ids(1:0), options=rcbd_step_options(removed=n))
    call check(step%report%n == 0, 'a step without rows')
  end subroutine

  subroutine finite()
    type(rcbd_scene) :: scene
    type(rcbd_cuts) :: cuts
    type(rcbd_halo) :: halo
    integer(int32), allocatable :: part(:)
    real(real64) :: weights(n)
    call open_new(scene, 'finite')
    call scene%step(x)
    call scene%cuts(cuts)
    x(2, 18) = nan()
    call scene%step(x, stat=stat, errmsg=why)
    call failed(rcbd_not_finite, '17')  ! messages are the library's, and count from 0
    call cuts%owner(x, part, stat=stat, errmsg=why)
    call failed(rcbd_not_finite, '17')
    call cuts%halo(x, rcbd_near(), halo, stat=stat, errmsg=why)
    call failed(rcbd_not_finite, '17')
    call rcbd_wrap(x, [0._real64, 0._real64, 0._real64], [1._real64, 1._real64, 1._real64], stat, why)
    call failed(rcbd_not_finite, '17')
    x(2, 18) = 0.5_real64
    call scene%step(x)
    call open_new(scene, 'weighted')
    weights = 1
    weights(6) = -1
    call scene%step(x, weights=weights, stat=stat, errmsg=why)
    call check(stat /= rcbd_ok .and. index(why, '5') > 0, 'a negative weight')
    weights(::2) = 1
    weights(2::2) = -1
    call scene%step(x(:, ::2), weights=weights(::2))
  end subroutine

  subroutine going_on()
    type(rcbd_client) :: client
    type(rcbd_scene) :: scene
    integer(int64) :: last
    call connect(client)
    call scene%open(client, 'going-on', stat=stat, errmsg=why)
    call failed(rcbd_not_found, 'going-on')
    call scene%open(client, 'going-on', rcbd_scene_options(parts=4))
    last = scene%last_step()
    call check(last == -1, 'no last step')
    call scene%step(x)
    call scene%open(client, 'going-on', rcbd_scene_options(parts=4))
    last = scene%last_step()
    call check(last == 0, 'the last step')
    call scene%open(client, 'going-on', rcbd_scene_options(parts=4, tolerance=0.2_real64), stat, why)
    call failed(rcbd_already_exists, 'tolerance is 0.1, not 0.2')
    call scene%open(client, 'going-on', rcbd_scene_options(parts=4, policy='tolerance', method='rcb', positions='every-step', &
                                                           part_sizes=[1, 2, 3, 4] * 1._real64, replace=.true.))
    call scene%step(x)
    call scene%release()
    call client%drop('going-on')
    call client%drop('going-on', stat, why)
    call failed(rcbd_not_found, 'going-on')
    call scene%open(client, 'no name', rcbd_scene_options(parts=4), stat, why)
    call failed(rcbd_invalid_argument, 'name')
  end subroutine

  subroutine closed()
    type(rcbd_client) :: client
    type(rcbd_scene) :: scene, other
    type(rcbd_op) :: op
    type(rcbd_step) :: step
    logical :: done
    call connect(client)
    call scene%open(client, 'closed', rcbd_scene_options(parts=8, replace=.true.))
    call scene%step(x)
    call scene%close()
    call scene%close()
    call scene%step(x, stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, '''closed'' was closed')
    call scene%step_begin(x, op)
    call op%wait(step, done=done, stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, '''closed'' was closed')
    call check(done, 'a step that failed is done')
    call scene%open(client, 'closed', rcbd_scene_options(parts=8))
    call other%open(client, 'other', rcbd_scene_options(parts=8, replace=.true.))
    call client%close()
    call other%step(x, stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, 'client was closed')
  end subroutine

  subroutine boxes()
    type(rcbd_scene) :: scene
    type(rcbd_cuts) :: cuts
    type(rcbd_halo) :: halo
    integer(int32), allocatable :: part(:)
    real(real64), parameter :: lo(3) = 0, hi(3) = 1, flat(3) = [1, 0, 1]
    call open_new(scene, 'boxes')
    call scene%step(x)
    call scene%cuts(cuts)
    call cuts%halo(x, rcbd_near(width=-1._real64), halo, stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, '')
    call cuts%halo(x, rcbd_near(width=nan()), halo, stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, '')
    call cuts%halo(x, rcbd_near(width=0.1_real64, lo=lo), halo, stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, 'one is missing')
    call cuts%halo(x, rcbd_near(width=0.1_real64, lo=lo, hi=flat), halo, stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, '')
    call cuts%halo(x, rcbd_near(width=0.1_real64, lo=lo(:2), hi=hi(:2)), halo, stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, 'other lengths')
    call cuts%halo(x, rcbd_near(width=0.1_real64, norm=9), halo, stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, 'norm')
    call cuts%neighbours(8, rcbd_near(width=0.1_real64), part, stat=stat, errmsg=why)
    call failed(rcbd_not_found, '8')
    call cuts%neighbours(-1, rcbd_near(width=0.1_real64), part, stat=stat, errmsg=why)
    call failed(rcbd_not_found, '-1')
    call cuts%box(lo(:2), hi, part, stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, 'other lengths')
    call rcbd_wrap(x, lo, hi(:2), stat, why)
    call failed(rcbd_invalid_argument, 'other lengths')
    call rcbd_wrap(x, lo, flat, stat, why)
    call failed(rcbd_invalid_argument, '')
  end subroutine

  subroutine ends()
    type(rcbd_scene) :: scene
    call scene%step(x)
  end subroutine

  subroutine assigned()
    type(rcbd_scene) :: scene
    type(rcbd_client) :: client
    call open_new(scene, 'assigned')
    client = scene
  end subroutine
end program
