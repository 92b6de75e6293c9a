! A solver of one process in Fortran: 3,000 points that drift, 100 steps, in 8 parts. Prints when new cuts were made.
program serial
  use, intrinsic :: iso_fortran_env, only: real64
  use rcbd
  implicit none
  type(rcbd_client) :: client
  type(rcbd_scene) :: scene
  type(rcbd_step) :: step
  real(real64) :: x(3, 3000)
  integer :: i, k
  x = reshape([(mod(i * 0.61803398875_real64, 1.0_real64), i = 0, 8999)], [3, 3000])
  call client%connect()
  call scene%open(client, 'serial', rcbd_scene_options(parts=8, replace=.true.))
  do k = 0, 100
    call scene%step(x, step)
    if (step%report%repartitioned) print '(a, i0, 2a)', 'step ', k, ': ', step%report%reason
    x(:, :1500) = x(:, :1500) * 0.99_real64  ! the solver's own work: half of them drift
  end do
end program
