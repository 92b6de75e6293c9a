! What the Fortran test programs share: a service to be asked, points, and checks that say what they found instead.
module expect
  use, intrinsic :: iso_fortran_env, only: error_unit, int32, int64, real32, real64
  use rcbd
  implicit none
  integer, parameter :: n = 3000
  real(real64) :: x(3, n)
  integer :: stat
  character(500) :: why
  character(200) :: endpoint
contains
  ! Fails with what was asked for, unless `right`.
  subroutine check(right, what)
    logical, intent(in) :: right
    character(*), intent(in) :: what
    if (right) return
    write (error_unit, '(5a, i0)') 'not so: ', what, '; the last message was: ', trim(why), '; stat ', stat
    error stop 1
  end subroutine

  ! The last call failed like this, in words.
  subroutine failed(code, words)
    integer, intent(in) :: code
    character(*), intent(in) :: words
    call check(stat == code .and. index(why, words) > 0, rcbd_code_name(code) // ': ' // words)
    stat = 0
    why = ''
  end subroutine

  ! The case that is asked for; without arguments lists them.
  function asked_for(cases) result(name)
    character(*), intent(in) :: cases(:)
    character(20) :: name
    integer :: i
    if (command_argument_count() == 0) print '(a)', cases
    name = ''
    if (command_argument_count() < 2) return
    call get_command_argument(1, endpoint)
    call get_command_argument(2, name)
    x = reshape([(mod(i * 0.61803398875_real64, 1.0_real64), i = 0, 3 * n - 1)], [3, n])
    stat = 0
    why = ''
  end function

  subroutine connect(client)
    type(rcbd_client), intent(inout) :: client
    call client%connect(endpoint)
  end subroutine

  subroutine open_new(scene, name)
    type(rcbd_scene), intent(inout) :: scene
    character(*), intent(in) :: name
    type(rcbd_client) :: client
    call connect(client)
    call scene%open(client, name, rcbd_scene_options(parts=8, replace=.true.))
  end subroutine

  elemental real(real64) function nan()
    nan = transfer(9221120237041090560_int64, nan)
  end function
end module
