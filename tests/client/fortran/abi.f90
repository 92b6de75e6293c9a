! Prints the places of all components of the types that rcbd.f90 gives to the library, as tests/client/c/abi.c does of the
! structs. tests/client/c/abi.txt keeps both.
program abi
  use rcbd_c
  implicit none
  type(c_connect_options), target :: c
  type(c_scene_options), target :: s
  type(c_positions), target :: p
  type(c_step_options), target :: t
  type(c_report), target :: r
  type(c_cuts_info), target :: i
  type(c_near), target :: n
  type(c_ask_options), target :: a
  type(c_lists_view), target :: l
  integer(c_intptr_t) :: first
  character(:), allocatable :: struct
  call head('rcbd_connect_options', c_loc(c), c_sizeof(c))
  call field('size', c_loc(c%size), c_sizeof(c%size))
  call field('name', c_loc(c%name), c_sizeof(c%name))
  call field('token', c_loc(c%token), c_sizeof(c%token))
  call field('path', c_loc(c%path), c_sizeof(c%path))
  call field('deadline_seconds', c_loc(c%deadline_seconds), c_sizeof(c%deadline_seconds))
  call field('outlive', c_loc(c%outlive), c_sizeof(c%outlive))
  call field('reserved', c_loc(c%reserved), c_sizeof(c%reserved))
  call head('rcbd_scene_options', c_loc(s), c_sizeof(s))
  call field('size', c_loc(s%size), c_sizeof(s%size))
  call field('parts', c_loc(s%parts), c_sizeof(s%parts))
  call field('dims', c_loc(s%dims), c_sizeof(s%dims))
  call field('method', c_loc(s%method), c_sizeof(s%method))
  call field('policy', c_loc(s%policy), c_sizeof(s%policy))
  call field('positions', c_loc(s%positions), c_sizeof(s%positions))
  call field('part_sizes', c_loc(s%part_sizes), c_sizeof(s%part_sizes))
  call field('tolerance', c_loc(s%tolerance), c_sizeof(s%tolerance))
  call field('axis_hysteresis', c_loc(s%axis_hysteresis), c_sizeof(s%axis_hysteresis))
  call field('cut_tolerance', c_loc(s%cut_tolerance), c_sizeof(s%cut_tolerance))
  call field('replace', c_loc(s%replace), c_sizeof(s%replace))
  call field('threads', c_loc(s%threads), c_sizeof(s%threads))
  call field('seat', c_loc(s%seat), c_sizeof(s%seat))
  call field('seats', c_loc(s%seats), c_sizeof(s%seats))
  call field('deadline_seconds', c_loc(s%deadline_seconds), c_sizeof(s%deadline_seconds))
  call head('rcbd_positions', c_loc(p), c_sizeof(p))
  call field('size', c_loc(p%size), c_sizeof(p%size))
  call field('count', c_loc(p%count), c_sizeof(p%count))
  call field('stride', c_loc(p%stride), c_sizeof(p%stride))
  call field('dims', c_loc(p%dims), c_sizeof(p%dims))
  call field('single', c_loc(p%single), c_sizeof(p%single))
  call field('axis', c_loc(p%axis), c_sizeof(p%axis))
  call head('rcbd_step_options', c_loc(t), c_sizeof(t))
  call field('size', c_loc(t%size), c_sizeof(t%size))
  call field('step', c_loc(t%step), c_sizeof(t%step))
  call field('ids', c_loc(t%ids), c_sizeof(t%ids))
  call field('weights', c_loc(t%weights), c_sizeof(t%weights))
  call field('inserted', c_loc(t%inserted), c_sizeof(t%inserted))
  call field('removed', c_loc(t%removed), c_sizeof(t%removed))
  call field('step_seconds', c_loc(t%step_seconds), c_sizeof(t%step_seconds))
  call field('want_parts', c_loc(t%want_parts), c_sizeof(t%want_parts))
  call field('want_changed', c_loc(t%want_changed), c_sizeof(t%want_changed))
  call field('send', c_loc(t%send), c_sizeof(t%send))
  call field('threads', c_loc(t%threads), c_sizeof(t%threads))
  call field('deadline_seconds', c_loc(t%deadline_seconds), c_sizeof(t%deadline_seconds))
  call head('rcbd_report', c_loc(r), c_sizeof(r))
  call field('size', c_loc(r%size), c_sizeof(r%size))
  call field('step', c_loc(r%step), c_sizeof(r%step))
  call field('epoch', c_loc(r%epoch), c_sizeof(r%epoch))
  call field('n', c_loc(r%n), c_sizeof(r%n))
  call field('error_before', c_loc(r%error_before), c_sizeof(r%error_before))
  call field('error', c_loc(r%error), c_sizeof(r%error))
  call field('imbalance', c_loc(r%imbalance), c_sizeof(r%imbalance))
  call field('drifted', c_loc(r%drifted), c_sizeof(r%drifted))
  call field('moved', c_loc(r%moved), c_sizeof(r%moved))
  call field('migrated', c_loc(r%migrated), c_sizeof(r%migrated))
  call field('inserted', c_loc(r%inserted), c_sizeof(r%inserted))
  call field('removed', c_loc(r%removed), c_sizeof(r%removed))
  call field('strangers', c_loc(r%strangers), c_sizeof(r%strangers))
  call field('weights_as_zero', c_loc(r%weights_as_zero), c_sizeof(r%weights_as_zero))
  call field('positions_step', c_loc(r%positions_step), c_sizeof(r%positions_step))
  call field('bytes', c_loc(r%bytes), c_sizeof(r%bytes))
  call field('scanned', c_loc(r%scanned), c_sizeof(r%scanned))
  call field('searched', c_loc(r%searched), c_sizeof(r%searched))
  call field('rounds', c_loc(r%rounds), c_sizeof(r%rounds))
  call field('reductions', c_loc(r%reductions), c_sizeof(r%reductions))
  call field('seconds_receive', c_loc(r%seconds_receive), c_sizeof(r%seconds_receive))
  call field('seconds_exchange', c_loc(r%seconds_exchange), c_sizeof(r%seconds_exchange))
  call field('seconds_search', c_loc(r%seconds_search), c_sizeof(r%seconds_search))
  call field('seconds_migrate', c_loc(r%seconds_migrate), c_sizeof(r%seconds_migrate))
  call field('seconds_total', c_loc(r%seconds_total), c_sizeof(r%seconds_total))
  call field('parts', c_loc(r%parts), c_sizeof(r%parts))
  call field('axes_flipped', c_loc(r%axes_flipped), c_sizeof(r%axes_flipped))
  call field('repartitioned', c_loc(r%repartitioned), c_sizeof(r%repartitioned))
  call field('sent', c_loc(r%sent), c_sizeof(r%sent))
  call field('reason', c_loc(r%reason), c_sizeof(r%reason))
  call field('way', c_loc(r%way), c_sizeof(r%way))
  call field('json', c_loc(r%json), c_sizeof(r%json))
  call head('rcbd_cuts_info', c_loc(i), c_sizeof(i))
  call field('size', c_loc(i%size), c_sizeof(i%size))
  call field('epoch', c_loc(i%epoch), c_sizeof(i%epoch))
  call field('hash', c_loc(i%hash), c_sizeof(i%hash))
  call field('parts', c_loc(i%parts), c_sizeof(i%parts))
  call field('dims', c_loc(i%dims), c_sizeof(i%dims))
  call head('rcbd_near', c_loc(n), c_sizeof(n))
  call field('size', c_loc(n%size), c_sizeof(n%size))
  call field('width', c_loc(n%width), c_sizeof(n%width))
  call field('lo', c_loc(n%lo), c_sizeof(n%lo))
  call field('hi', c_loc(n%hi), c_sizeof(n%hi))
  call field('norm', c_loc(n%norm), c_sizeof(n%norm))
  call field('reserved', c_loc(n%reserved), c_sizeof(n%reserved))
  call head('rcbd_ask_options', c_loc(a), c_sizeof(a))
  call field('size', c_loc(a%size), c_sizeof(a%size))
  call field('ids', c_loc(a%ids), c_sizeof(a%ids))
  call field('last_part', c_loc(a%last_part), c_sizeof(a%last_part))
  call field('widths', c_loc(a%widths), c_sizeof(a%widths))
  call field('entries_max', c_loc(a%entries_max), c_sizeof(a%entries_max))
  call field('seats', c_loc(a%seats), c_sizeof(a%seats))
  call field('threads', c_loc(a%threads), c_sizeof(a%threads))
  call head('rcbd_lists_view', c_loc(l), c_sizeof(l))
  call field('size', c_loc(l%size), c_sizeof(l%size))
  call field('lists', c_loc(l%lists), c_sizeof(l%lists))
  call field('entries', c_loc(l%entries), c_sizeof(l%entries))
  call field('offset', c_loc(l%offset), c_sizeof(l%offset))
  call field('item', c_loc(l%item), c_sizeof(l%item))
  call field('shift', c_loc(l%shift), c_sizeof(l%shift))
contains
  subroutine head(name, at, bytes)
    character(*), intent(in) :: name
    type(c_ptr), intent(in) :: at
    integer(c_size_t), intent(in) :: bytes
    struct = name
    first = transfer(at, first)
    print '(a, 1x, i0)', name, bytes
  end subroutine

  subroutine field(name, at, bytes)
    character(*), intent(in) :: name
    type(c_ptr), intent(in) :: at
    integer(c_size_t), intent(in) :: bytes
    print '(3a, 2(1x, i0))', struct, '.', name, transfer(at, first) - first, bytes
  end subroutine
end program
