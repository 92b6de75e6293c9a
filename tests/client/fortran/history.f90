! tests/client/c/history.c in Fortran, with the same arguments and the same output:
! fortran_history ENDPOINT SCENE FILE N DIMS STEPS PARTS POSITIONS SEAT SEATS.
program history
  use, intrinsic :: iso_fortran_env, only: error_unit, int32, int64, output_unit, real64
  use rcbd
  implicit none
  type(rcbd_client) :: client
  type(rcbd_scene) :: scene
  type(rcbd_step) :: result
  type(rcbd_cuts) :: cuts
  real(real64), allocatable :: all(:, :, :), x(:, :)  ! all: (dims, n, steps)
  integer(int64), allocatable :: ids(:)               ! of the rows that are mine; particle i has the id i - 1
  integer(int32), allocatable :: part(:)              ! of all
  integer :: n, dims, steps, parts, seat, seats, step, k, unit
  n = number(4)
  dims = number(5)
  steps = number(6)
  parts = number(7)
  seat = number(9)
  seats = number(10)
  allocate (all(dims, n, steps))
  open (newunit=unit, file=word(3), access='stream', form='unformatted', status='old', action='read')
  read (unit) all
  close (unit)
  ids = [(int(k, int64), k = seat, n - 1, seats)]
  call client%connect(word(1))
  call scene%open(client, word(2), rcbd_scene_options(parts=parts, dims=dims, positions=word(8), seat=seat, seats=seats, &
                                                      replace=.true.))
  print '(a)', 'made'
  flush (output_unit)
  do step = 1, steps
    x = all(:, ids + 1, step)
    call make()
    call scene%cuts(cuts)
    call cuts%owner(all(:, :, step), part)
    call print_step(result%report)
    call hand_over()
  end do
contains
  ! Each second step by another way to give the same.
  subroutine make()
    type(rcbd_step_options) :: options
    options%send = step == steps
    if (mod(step, 2) == 0) then
      call scene%step(x, result, ids, options=options)
    else if (dims == 3) then
      call scene%step(x(1, :), x(2, :), x(3, :), result, ids4=int(ids, int32), options=options)
    else
      call scene%step(x(1, :), x(2, :), result=result, ids=ids, options=options)
    end if
  end subroutine

  subroutine print_step(report)
    type(rcbd_report), intent(in) :: report
    if (cuts%epoch() /= report%epoch) call fail('cuts of another epoch than the report''s')
    print '(3(i0, 1x), 3(g0, 1x), 4(i0, 1x), a, 1x, i0)', report%step, report%n, report%parts, report%error_before, &
      report%error, report%imbalance, merge(1, 0, report%repartitioned), report%epoch, report%moved, report%axes_flipped, &
      cuts%hex_hash(), merge(1, 0, report%sent)
  end subroutine

  ! Takes over the particles of my parts, and checks that leaving_row names those that were mine and are no more.
  subroutine hand_over()
    integer :: left, row
    left = 0
    do row = 1, size(ids)
      if (seat_of(part(ids(row) + 1)) == seat) cycle
      left = left + 1
      if (left > size(result%leaving_row)) call fail('a row leaves that was not named')
      if (result%leaving_row(left) /= row .or. result%leaving_seat(left) /= seat_of(part(ids(row) + 1))) &
        call fail('a row leaves that was not named, or for another seat')
    end do
    if (left /= size(result%leaving_row)) call fail('more rows are named than leave')
    ids = pack([(int(k, int64), k = 0, n - 1)], [(seat_of(part(k)) == seat, k = 1, n)])
  end subroutine

  elemental integer function seat_of(of_part)
    integer(int32), intent(in) :: of_part
    seat_of = ((of_part + 1) * seats - 1) / parts
  end function

  function word(k) result(text)
    integer, intent(in) :: k
    character(:), allocatable :: text
    integer :: length
    call get_command_argument(k, length=length)
    allocate (character(length) :: text)
    call get_command_argument(k, text)
  end function

  integer function number(k)
    integer, intent(in) :: k
    character(:), allocatable :: text
    text = word(k)
    read (text, *) number
  end function

  subroutine fail(message)
    character(*), intent(in) :: message
    write (error_unit, '(a)') message
    error stop 1
  end subroutine
end program
