/* So that librcbd.so.1 of the archive (deploy/archive) runs where glibc is older than where it was built, down to 2.27:
   what newer ones have moved, or added, is asked of them by the oldest name and version, or written here. libstdc++ and
   libgcc, which are inside, call these too. Nothing of it is seen outside of the library. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <link.h>
#include <pthread.h>
#include <signal.h>
#include <stdint.h>
#include <sys/random.h>
#include <sys/stat.h>
#include <time.h>

#ifndef __x86_64__
#error "versions of other processors' glibc: see sysdeps/unix/sysv/linux/PROCESSOR/libc.abilist of its sources"
#endif

#define ASKED(version, type, name, parameters, arguments)    \
  extern type old_##name parameters;                         \
  __asm__(".symver old_" #name "," #name "@GLIBC_" version); \
  type name parameters { return old_##name arguments; }

/* Moved into libc.so.6 by 2.32 and 2.34; before, they are in libpthread.so.0 and libdl.so.2. */
ASKED("2.2.5", int, pthread_create,
      (pthread_t * thread, const pthread_attr_t* attributes, void* (*run)(void*), void* with),
      (thread, attributes, run, with))
ASKED("2.2.5", int, pthread_join, (pthread_t thread, void** result), (thread, result))
ASKED("2.2.5", int, pthread_detach, (pthread_t thread), (thread))
ASKED("2.2.5", int, pthread_once, (pthread_once_t * once, void (*run)(void)), (once, run))
ASKED("2.2.5", int, pthread_key_create, (pthread_key_t * key, void (*end)(void*)), (key, end))
ASKED("2.2.5", int, __pthread_key_create, (pthread_key_t * key, void (*end)(void*)), (key, end))
ASKED("2.2.5", int, pthread_key_delete, (pthread_key_t key), (key))
ASKED("2.2.5", void*, pthread_getspecific, (pthread_key_t key), (key))
ASKED("2.2.5", int, pthread_setspecific, (pthread_key_t key, const void* value), (key, value))
ASKED("2.2.5", int, pthread_sigmask, (int how, const sigset_t* set, sigset_t* before), (how, set, before))
ASKED("2.3.3", int, pthread_condattr_setclock, (pthread_condattr_t * attributes, clockid_t clock), (attributes, clock))
ASKED("2.2.5", void*, dlopen, (const char* file, int mode), (file, mode))
ASKED("2.2.5", void*, dlsym, (void* library, const char* name), (library, name))
ASKED("2.2.5", char*, dlerror, (void), ())

/* Functions since 2.33; before, the headers had them, by these. */
extern int __xstat(int, const char*, struct stat*), __fxstat(int, int, struct stat*),
    __lxstat(int, const char*, struct stat*);
__asm__(".symver __xstat,__xstat@GLIBC_2.2.5");
__asm__(".symver __fxstat,__fxstat@GLIBC_2.2.5");
__asm__(".symver __lxstat,__lxstat@GLIBC_2.2.5");
enum { kStatVersion = 1 };
int stat(const char* path, struct stat* told) { return __xstat(kStatVersion, path, told); }
int fstat(int file, struct stat* told) { return __fxstat(kStatVersion, file, told); }
int lstat(const char* path, struct stat* told) { return __lxstat(kStatVersion, path, told); }
int fstat64(int file, struct stat64* told) {
  return __fxstat(kStatVersion, file, (struct stat*)told);
} /* the same struct */

/* Since 2.32: whether there is one thread only, which then needs no atomic counts. */
char __libc_single_threaded = 0;

/* Since 2.30: waits by the given clock. Here by the real-time clock: should that be set meanwhile, the wait is shorter
   or longer. Callers look at their own clock, and wait again. */
int pthread_cond_clockwait(pthread_cond_t* condition, pthread_mutex_t* mutex, clockid_t clock,
                           const struct timespec* end) {
  struct timespec now, real;
  int64_t left;
  const int64_t second = 1000000000;
  clock_gettime(clock, &now);
  clock_gettime(CLOCK_REALTIME, &real);
  left = (end->tv_sec - now.tv_sec) * second + (end->tv_nsec - now.tv_nsec);
  if (left < 0) left = 0;
  left += real.tv_nsec;
  real.tv_sec += left / second;
  real.tv_nsec = left % second;
  return pthread_cond_timedwait(condition, mutex, &real);
}

/* Since 2.36. */
uint32_t arc4random(void) {
  uint32_t number = 0;
  while (getrandom(&number, sizeof number, 0) != (ssize_t)sizeof number && errno == EINTR) {
  }
  return number;
}

/* Since 2.35: where an exception finds what to unwind by. */
struct Search {
  uintptr_t address;
  struct dl_find_object* found;
};

static int look_into(struct dl_phdr_info* object, size_t size, void* data) {
  struct Search* search = data;
  const ElfW(Phdr) * part;
  int has = 0;
  (void)size;
  search->found->dlfo_eh_frame = NULL;
  for (part = object->dlpi_phdr; part < object->dlpi_phdr + object->dlpi_phnum; ++part) {
    const uintptr_t begin = object->dlpi_addr + part->p_vaddr;
    if (part->p_type == PT_GNU_EH_FRAME) search->found->dlfo_eh_frame = (void*)begin;
    if (part->p_type != PT_LOAD || search->address < begin || search->address - begin >= part->p_memsz) continue;
    has = 1;
    search->found->dlfo_map_start = (void*)begin;
    search->found->dlfo_map_end = (void*)(begin + part->p_memsz);
  }
  return has && search->found->dlfo_eh_frame != NULL;
}

int _dl_find_object(void* address, struct dl_find_object* found) {
  struct Search search = {(uintptr_t)address, found};
  return dl_iterate_phdr(look_into, &search) ? 0 : -1;
}
