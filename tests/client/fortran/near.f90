! What questions about cuts answer, against their definitions.
program near_parts
  use expect
  implicit none
  real(real64), parameter :: infinity = transfer(9218868437227405312_int64, 1._real64)
  type(rcbd_scene) :: scene
  type(rcbd_step) :: step
  type(rcbd_cuts) :: cuts
  type(rcbd_near) :: near
  real(real64), allocatable :: lo(:, :), hi(:, :)
  character(20) :: name
  name = asked_for(['owner     ', 'halo      ', 'neighbours', 'wrap      '])
  if (name == '') stop
  call open_new(scene, name)
  call scene%step(x, step, options=rcbd_step_options(want_parts=.true.))
  call scene%cuts(cuts)
  call cuts%regions(lo, hi)
  near = rcbd_near(width=0.07_real64, lo=[0._real64, -infinity, 0._real64], hi=[1._real64, infinity, 1._real64])
  select case (name)
  case ('owner')
    call owner()
  case ('halo')
    call halos()
  case ('neighbours')
    call neighbours()
  case ('wrap')
    call wrapped()
  end select
contains
  subroutine owner()
    integer(int32), allocatable :: part(:)
    integer :: i
    call cuts%owner(x, part)
    call check(all(part == step%part), 'owners are the parts that the step told')
    call check(lbound(lo, 2) == 0 .and. ubound(hi, 2) == 7 .and. size(lo, 1) == 3, 'regions by part')
    do i = 1, n
      call check(all(x(:, i) >= lo(:, part(i)) .and. x(:, i) <= hi(:, part(i))), 'in its region')
    end do
  end subroutine

  ! The distance of an image from a part's region, clipped to the periodic box.
  real(real64) function distance(i, sx, sz, part)
    integer, intent(in) :: i, sx, sz, part
    real(real64) :: image(3), low(3), high(3)
    image = x(:, i) + [sx, 0, sz]
    low = max(lo(:, part), near%lo)
    high = min(hi(:, part), near%hi)
    distance = max(0._real64, maxval(low - image), maxval(image - high))
  end function

  subroutine halos()
    type(rcbd_halo) :: halo, single, axes, seats
    real(real32) :: x4(3, n)
    integer :: part, i, sx, sz
    integer(int64) :: e
    call cuts%halo(x, near, halo)
    call check(ubound(halo%offset, 1) == 8 .and. lbound(halo%offset, 1) == 0 .and. size(halo%row) > 100, 'lists')
    e = 0
    do part = 0, 7
      do i = 1, n
        do sx = -1, 1
          do sz = -1, 1
            if (distance(i, sx, sz, part) > near%width .or. (step%part(i) == part .and. sx == 0 .and. sz == 0)) cycle
            e = e + 1
            call check(e <= halo%offset(part + 1), 'no entry is missing')
            call check(halo%row(e) == i .and. all(halo%shift(:, e) == [sx, 0, sz]), 'each is the right one')
          end do
        end do
      end do
    end do
    call check(e == size(halo%row), 'no entry is too many')
    call cuts%halo(x(1, :), x(2, :), x(3, :), near, axes, ids=[(int(i, int64), i = 0, n - 1)])
    call check(size(axes%row) == e, 'as many by axes')
    call check(all(axes%row == halo%row) .and. all(axes%shift == halo%shift), 'the same by axes')
    x4 = real(x, real32)
    x = x4
    call cuts%halo(x, near, halo)
    call cuts%halo(x4, near, single, ids4=[(int(i, int32), i = 0, n - 1)])
    call cuts%halo(x4(1, :), x4(2, :), x4(3, :), near, axes)
    call check(all(single%row == halo%row) .and. all(axes%row == halo%row), 'the same in single precision')
    call cuts%halo(x, near, seats, options=rcbd_ask_options(seats=2, widths=[(near%width, i = 1, n)]))
    call check(ubound(seats%offset, 1) == 2 .and. seats%offset(2) < e .and. seats%offset(2) > 100, 'lists of seats')
    call cuts%halo(x, rcbd_near(), seats)
    call check(all(seats%shift == 0), 'no box, no shifts')
  end subroutine

  subroutine neighbours()
    integer(int32), allocatable :: part(:), touched(:), shift(:, :)
    integer(int32) :: narrow, axis
    real(real64) :: width
    integer :: p, k
    logical :: across
    across = .false.
    do p = 0, 7
      call cuts%neighbours(p, near, part, shift)
      call check(size(part) > 3 .and. all(shape(shift) == [3, size(part)]) .and. all(part >= 0 .and. part < 8), 'neighbours')
      call check(all(shift(2, :) == 0), 'no shifts along an axis that is not periodic')
      across = across .or. any(shift(1, :) /= 0)
      call cuts%box(max(lo(:, p), 0._real64) - near%width, min(hi(:, p), 1._real64) + near%width, touched)
      do k = 1, size(touched)
        if (touched(k) /= p) call check(any(part == touched(k) .and. all(shift == 0, dim=1)), 'what a wider box touches is one')
      end do
    end do
    call check(across, 'neighbours across a border')
    call cuts%narrowest(narrow, axis, width, near)
    call check(abs(width - (min(hi(axis, narrow), 1._real64) - max(lo(axis, narrow), 0._real64))) < 1e-12_real64, 'width')
    call cuts%box([0, 0, 0] * 1._real64, [1, 1, 1] * 1._real64, touched)
    call check(size(touched) == 8, 'all parts')
  end subroutine

  subroutine wrapped()
    real(real64) :: y(3, 4), z(3, 4)
    real(real32) :: s(3, 2)
    y(:, 1) = [-0.25_real64, -5._real64, 0._real64]
    y(:, 2) = [1._real64, 5._real64, 1._real64]
    y(:, 3) = [2.75_real64, 0._real64, -1e-30_real64]
    y(:, 4) = [0.3_real64, 0._real64, 0.5_real64]
    z = y
    call rcbd_wrap(y, near%lo, near%hi)
    call check(all(abs(y(2, :) - z(2, :)) <= 0), 'an axis that is not periodic')
    call check(all(abs(y(1, :) - [0.75_real64, 0._real64, 0.75_real64, 0.3_real64]) <= 0), 'by whole periods')
    call check(all(abs(y(3, :) - [0._real64, 0._real64, 0._real64, 0.5_real64]) <= 0), 'what is rounded to hi goes to lo')
    s(:, 1) = [-0.25, 3., 1.]
    s(:, 2) = [1.5, -3., 2.5]
    call rcbd_wrap(s, near%lo, near%hi)
    call check(all(abs(s(1, :) - [0.75, 0.5]) <= 0) .and. all(abs(s(3, :) - [0., 0.5]) <= 0), 'single precision')
    s(1, :) = [4.5, -0.5]
    call rcbd_wrap(s(1, :), lo=near%lo(1:1), hi=near%hi(1:1))
    call check(all(abs(s(1, :) - 0.5) <= 0), 'one axis')
  end subroutine
end program
