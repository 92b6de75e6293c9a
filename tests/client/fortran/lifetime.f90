! Who holds what, and for how long.
program lifetime
  use expect
  implicit none
  type :: solver
    type(rcbd_scene) :: scene
    integer :: k = 0
  end type
  select case (asked_for(['scopes    ', 'copies    ', 'components', 'restored  ', 'grown     ', 'arrays    ', 'results   ', &
                          'begun     ', 'notices   ']))
  case ('scopes')
    call scopes()
  case ('copies')
    call copies()
  case ('components')
    call components()
  case ('restored')
    call restored()
  case ('grown')
    call grown()
  case ('arrays')
    call arrays()
  case ('results')
    call results()
  case ('begun')
    call begun()
  case ('notices')
    call notices()
  end select
contains
  ! Whether nobody has the scene open; then it is made anew.
  logical function is_free(name)
    character(*), intent(in) :: name
    type(rcbd_client) :: client
    type(rcbd_scene) :: scene
    call connect(client)
    call scene%open(client, name, rcbd_scene_options(parts=2, replace=.true., deadline_seconds=0.1_real64), stat, why)
    is_free = stat == rcbd_ok
    if (.not. is_free) call failed(rcbd_busy, name)
  end function

  subroutine scopes()
    type(rcbd_scene), allocatable :: scene, row(:)
    call in_a_scope(.false.)
    call check(is_free('scope'), 'a scene that ceased to exist is free')
    call in_a_scope(.true.)
    call check(is_free('scope'), 'so is one that was left early')
    allocate (scene)
    call open_new(scene, 'scope')
    call check(.not. is_free('scope'), 'a scene that exists is not free')
    deallocate (scene)
    call check(is_free('scope'), 'a scene that was deallocated is free')
    allocate (row(2))
    call open_new(row(1), 'scope')
    call open_new(row(2), 'other')
    call row(1)%release()
    call check(is_free('scope') .and. .not. is_free('other'), 'one of two was released')
    call open_new(row(2), 'scope')
    call check(is_free('other') .and. .not. is_free('scope'), 'another was opened in its place')
    deallocate (row)
    call check(is_free('scope'), 'an array was deallocated')
  end subroutine

  subroutine in_a_scope(early)
    logical, intent(in) :: early
    type(rcbd_scene) :: scene
    call open_new(scene, 'scope')
    call check(.not. is_free('scope'), 'a scene that is open is not free')
    if (early) return
    call scene%step(x)
  end subroutine

  subroutine copies()
    type(rcbd_scene) :: one, two, row(3)
    type(rcbd_scene), allocatable :: more(:), less(:)
    call open_new(one, 'copies')
    two = one
    one = one
    two = two
    call one%release()
    call check(.not. is_free('copies'), 'the copy holds it')
    call two%step(x)
    row = two
    call two%release()
    call row(2)%step(x)
    row(1:2) = row(2:3)
    allocate (more(2), less(1))
    more = row(2:3)
    less(1) = more(2)
    call row%release()
    call check(.not. is_free('copies'), 'elements hold it')
    call more(1)%step(x)
    call move_alloc(less, more)
    one = same(more(1))
    call more(1)%release()
    call one%step(x)
    call leave_copy(one)
    call one%step(x)
    one = row(1)
    call one%step(x, stat=stat, errmsg=why)
    call failed(rcbd_invalid_argument, 'NULL')
  end subroutine

  subroutine leave_copy(scene)
    type(rcbd_scene), intent(in) :: scene
    type(rcbd_scene) :: copy
    class(rcbd_scene), allocatable :: source
    copy = scene
    allocate (source, source=scene)
  end subroutine

  function same(scene) result(it)
    type(rcbd_scene), intent(in) :: scene
    type(rcbd_scene) :: it
    it = scene
  end function

  ! Copies of types that have handles: whatever a compiler makes of them, nothing is let go of twice.
  subroutine components()
    type(solver) :: one, two, row(2)
    type(solver), allocatable :: more(:)
    integer :: k
    call open_new(one%scene, 'components')
    do k = 1, 20
      two = one
      row = two
      two = row(1)
      more = [one, two]
      more(1) = one
      call leave_component(one)
    end do
    deallocate (more)
    call one%scene%step(x)
    call two%scene%step(x)
    call one%scene%step(x)
  end subroutine

  subroutine leave_component(it)
    type(solver), intent(in) :: it
    type(solver) :: copy, other
    copy = it
    other = copy
    other = solver(scene=copy%scene, k=1)
  end subroutine

  ! A copy that comes back to where it was made when what it holds is long released, and another variable's handle in its place.
  subroutine restored()
    type(solver) :: now, saved
    type(rcbd_scene) :: other
    type(rcbd_client) :: client
    integer :: k
    call connect(client)
    do k = 1, 20
      call now%scene%open(client, 'restored', rcbd_scene_options(parts=8, replace=.true.))
      saved = now
      now = saved
      call now%scene%step(x)
      call now%scene%release()
      call other%open(client, 'other', rcbd_scene_options(parts=8, replace=.true.))
      now = saved
      call now%scene%step(x, stat=stat, errmsg=why)
      call failed(rcbd_invalid_argument, 'NULL')
      call now%scene%release()
      call saved%scene%release()
      call check(other%last_step() == -1, 'the other scene was not stepped')
      call other%step(x)
      call other%release()
    end do
  end subroutine

  ! An array of types that have handles is made longer: the copies are null handles, those of components by themselves hold.
  subroutine grown()
    type(solver), allocatable :: some(:), more(:)
    allocate (some(2), more(3))
    call open_new(some(1)%scene, 'grown')
    call open_new(some(2)%scene, 'lost')
    more(:2) = some
    more(1)%scene = some(1)%scene
    deallocate (some)
    call move_alloc(more, some)
    call some(1)%scene%step(x)
    call check(.not. is_free('grown'), 'the component that was copied by itself holds the scene')
    call some(2)%scene%step(x, stat=stat, errmsg=why)
    if (stat /= rcbd_ok) call failed(rcbd_invalid_argument, 'NULL')
  end subroutine

  ! Arrays are touched after growth, steps, close and the end of everything.
  subroutine arrays()
    type(rcbd_scene) :: scene
    type(rcbd_memory) :: small, large, other
    type(rcbd_step) :: step
    real(real64), pointer :: few(:, :), many(:, :)
    real(real32), pointer :: single(:, :)
    call open_new(scene, 'arrays')
    call scene%positions(n, few, small)
    call check(all(shape(few) == [3, n]), 'the shape')
    few = x
    call scene%step(few)
    call scene%positions(40 * n, many, large)
    call check(all(abs(many(:, :n) - x) <= 0), 'values that were there stay')
    few = few * 0.9_real64
    call scene%step(few)
    call scene%step(many(:, :n), step)
    call check(step%report%n == n .and. step%report%step == 2, 'three steps')
    call scene%positions(0, single, other)
    call check(size(single) == 0, 'no room')
    call scene%positions(5, single, other)
    single = 0.5
    call open_new(scene, 'more')
    call scene%step(single)
    other = small
    call small%release()
    call scene%close()
    few = few + 1
    call scene%release()
    few = few - 1
    many = many + 1
    call check(all(abs(many(:, :n) - x - 1) < 1e-12_real64), 'they are still there')
    call check(all(abs(few - x * 0.9_real64) < 1e-12_real64), 'and these')
  end subroutine

  ! What was told is the caller's.
  subroutine results()
    type(rcbd_scene) :: scene
    type(rcbd_step) :: step, kept
    type(rcbd_cuts) :: cuts, later
    type(rcbd_step_options) :: options
    integer(int32), allocatable :: part(:)
    character(16) :: hash
    call open_new(scene, 'results')
    options%want_parts = .true.
    options%want_changed = .true.
    call scene%step(x, step, options=options)
    call scene%cuts(cuts)
    hash = cuts%hex_hash()
    kept = step
    x = x**2
    call scene%step(x, step)
    call check(.not. allocated(step%part) .and. .not. allocated(step%changed_row), 'not wanted, not there')
    call scene%cuts(later)
    call scene%close()
    call scene%release()
    call check(kept%report%step == 0 .and. kept%report%reason == 'first positions' .and. len(kept%report%json) > 100, 'texts')
    call check(size(kept%part) == n .and. size(kept%changed_row) == n .and. kept%changed_row(1) == 1 .and. &
               all(kept%changed_part == kept%part) .and. size(kept%leaving_row) == 0, 'rows')
    call check(hash == cuts%hex_hash() .and. hash /= later%hex_hash() .and. later%epoch() == 2, 'cuts do not change')
    call later%owner(x, part)
    call later%owner(x, part)
    cuts = later
    call later%release()
    call check(cuts%parts() == 8 .and. cuts%dims() == 3, 'cuts that were assigned')
  end subroutine

  subroutine begun()
    type(rcbd_scene) :: scene
    type(rcbd_op) :: op, copy
    type(rcbd_step) :: step
    logical :: done
    real(real64), target, asynchronous, save :: mine(3, n)
    integer :: k
    mine = x
    call open_new(scene, 'begun')
    call scene%step_begin(mine, op)
    copy = op
    call op%wait(step, done=done)
    call check(done .and. step%report%step == 0, 'a step that was begun')
    call copy%wait(step)
    call check(step%report%step == 0, 'asked once more')
    done = .false.
    call open_new(scene, 'halves')
    call scene%step_begin(mine(:, ::2), op, options=rcbd_step_options(want_parts=.true.))
    do while (.not. done)
      call op%wait(step, 0.001_real64, done, stat, why)
    end do
    call check(stat == rcbd_ok, 'waited for in slices')
    call check(size(step%part) == n / 2, 'each second row')
    call op%release()
    call copy%release()
    call open_new(scene, 'begun')
    do k = 1, 20
      call scene%step_begin(mine, op)
      call op%cancel()
      call op%wait(stat=stat, errmsg=why)
      call check(stat == rcbd_ok .or. stat == rcbd_interrupted, 'made or interrupted')
      call scene%step_begin(mine, op)
      call op%release()
    end do
    call scene%step_begin(mine, op)
    call scene%release()
    call op%wait(step)
    call check(step%report%n == n, 'an op holds its scene')
  end subroutine

  subroutine notices()
    type(rcbd_client) :: client
    character(:), allocatable :: text
    call connect(client)
    call client%interrupt()
    call check(.not. client%notice(text), 'no notice')
    call check(rcbd_version() >= 100 .and. rcbd_code_name(rcbd_busy) == 'busy', 'names')
  end subroutine
end program
