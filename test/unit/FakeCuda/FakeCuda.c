//===- FakeCuda.c - A CUDA driver without a GPU, for tests ----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The functions of libcuda.so.1 that the runtime calls, over memory of the
// host. The environment variable TAI_FAKE_CUDA is a list of words for
// faults and features: no-device, zero-devices, old, busy, small (a
// megabyte of memory), no-pools, bad-ptx, fault (launches fail when they
// are waited for), heap-in-use (its size cannot be changed), no-graphs,
// fixed-graphs (their parameters stay), any-function (modules have
// functions of all names, which do nothing), overlaps (launches can),
// likes-512 (a launch takes 400 microseconds in blocks of 512 threads, and
// 900 else), list-graphs (their nodes are written to standard error),
// side-first (branches of graphs come as early as they may, else as late).
// The clock of the device advances by a microsecond with each piece of
// work, and by a launch of "scale" by one for each thousand numbers. A
// module has the functions "scale" (double *x, int64_t n, double factor),
// "add" (the same), "where" (int32_t *blocks_and_threads) and "until"
// (uint32_t *word), whatever its text is, and those of Rows.cu. The last
// one runs until somebody writes a number to the word, which it then
// writes behind it. With TAI_FAKE_CUDA_IMAGES, a folder, loaded modules
// are kept there: 000.ptx and so on. Compiled with -finstrument-functions,
// it counts how often it is called. Graphs are lists of launches, fills
// and copies.
//
//===----------------------------------------------------------------------===//

#define NOT_COUNTED __attribute__((no_instrument_function))
#define TAI_FILL_FUNCTION NOT_COUNTED static inline
#include "../../../lib/Runtime/Cuda/FillTable.h"

#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef int Result;
typedef unsigned long long Address;
enum { NotReady = 600 };

/// Calls of functions of the driver, so that tests can count them.
long long tai_fake_cuda_calls;
NOT_COUNTED void __cyg_profile_func_enter(void *callee, void *caller) {
  (void)callee, (void)caller;
  ++tai_fake_cuda_calls;
}
NOT_COUNTED void __cyg_profile_func_exit(void *callee, void *caller) {
  (void)callee, (void)caller;
}

NOT_COUNTED static int has(const char *word) {
  const char *given = getenv("TAI_FAKE_CUDA");
  return given && strstr(given, word) != NULL;
}

enum { mostValues = sizeof(TaiFillTable) / 8, mostNodes = 16384 };

/// A piece of work: a launch (0), a copy (1) or a fill (2).
typedef struct {
  int kind;
  const char *function;
  unsigned blocks, threads;
  /// Whether it may start while the one before it runs.
  int overlaps;
  uint64_t values[mostValues];
} FakeNode;

/// With an empty node at its end.
typedef struct FakeGraph {
  FakeNode nodes[mostNodes + 1];
  int count;
  struct FakeGraph *origin;
} FakeGraph;

/// Each thread has a context of its own, or none.
static __thread void *current;
static int context, stream, side, module, faulted;
/// The word that "until" looks at while it runs; null while it does not.
static volatile uint32_t *awaited;
/// A word that is copied behind a running "until": one, at most.
static struct {
  uint32_t *to, word;
} late;

Result cuInit(unsigned flags) {
  (void)flags;
  return has("no-device") ? 100 : 0;
}
Result cuDriverGetVersion(int *version) {
  *version = has("old") ? 11040 : 12080;
  return 0;
}
Result cuGetErrorName(Result result, const char **text) {
  *text = result == 2     ? "CUDA_ERROR_OUT_OF_MEMORY"
          : result == 46  ? "CUDA_ERROR_DEVICE_UNAVAILABLE"
          : result == 218 ? "CUDA_ERROR_INVALID_PTX"
          : result == 700 ? "CUDA_ERROR_ILLEGAL_ADDRESS"
                          : "CUDA_ERROR_UNKNOWN";
  return 0;
}
Result cuGetErrorString(Result result, const char **text) {
  *text = result == 2     ? "out of memory"
          : result == 46  ? "device busy or unavailable"
          : result == 218 ? "invalid PTX"
          : result == 700 ? "an illegal memory access was encountered"
                          : "unknown error";
  return 0;
}
Result cuDeviceGetCount(int *count) {
  *count = has("zero-devices") ? 0 : 2;
  return 0;
}
Result cuDeviceGet(int *device, int ordinal) {
  *device = ordinal;
  return 0;
}
Result cuDeviceGetName(char *name, int bytes, int device) {
  snprintf(name, (size_t)bytes, "Fake GPU %d", device);
  return 0;
}

/// Bytes of the device, and those that are taken.
static size_t taken;
NOT_COUNTED static size_t total(void) {
  return has("small") ? (size_t)1 << 20 : (size_t)1 << 34;
}
Result cuDeviceTotalMem_v2(size_t *bytes, int device) {
  (void)device;
  *bytes = total();
  return 0;
}
Result cuMemGetInfo_v2(size_t *left, size_t *all) {
  *all = total();
  *left = *all - taken;
  return 0;
}
Result cuDeviceGetAttribute(int *value, int attribute, int device) {
  (void)device;
  switch (attribute) {
  case 1: // threads of a block
    *value = 1024;
    return 0;
  case 16: // multiprocessors
    *value = 10;
    return 0;
  case 39: // threads of each
    *value = 2048;
    return 0;
  case 75:
    *value = has("ancient") ? 5 : 9;
    return 0;
  case 76:
    *value = 0;
    return 0;
  case 89:
    *value = has("managed");
    return 0;
  case 115:
    *value = !has("no-pools");
    return 0;
  case 120: // clusters, and launches that overlap
    *value = has("overlaps");
    return 0;
  }
  return 1;
}
Result cuDevicePrimaryCtxRetain(void **result, int device) {
  (void)device;
  if (has("busy"))
    return 46;
  *result = &context;
  return 0;
}
Result cuDevicePrimaryCtxRelease_v2(int device) {
  (void)device;
  faulted = 0;
  awaited = NULL;
  late.to = NULL;
  return 0;
}
Result cuCtxGetCurrent(void **result) {
  *result = current;
  return 0;
}
Result cuCtxSetCurrent(void *given) {
  current = given;
  return 0;
}
Result cuStreamCreate(void **result, unsigned flags) {
  *result = flags ? &side : &stream;
  return 0;
}
Result cuStreamDestroy_v2(void *given) {
  (void)given;
  return 0;
}
NOT_COUNTED static int isRunning(void *on) {
  if (on == &stream && awaited && awaited[0]) {
    awaited[1] = awaited[0];
    awaited = NULL;
    if (late.to)
      *late.to = late.word;
    late.to = NULL;
  }
  return on == &stream && awaited;
}
/// Waits for no "until".
Result cuStreamSynchronize(void *given) {
  (void)given;
  return faulted ? 700 : 0;
}

Result cuStreamQuery(void *given) {
  return isRunning(given) ? NotReady : cuStreamSynchronize(given);
}

/// The clock, in microseconds.
static long long now;

/// Events that there are, so that tests can count them.
typedef struct {
  long long time;
  void *on;
  int recorded;
} FakeEvent;
int tai_fake_cuda_events;
Result cuEventCreate(void **event, unsigned flags) {
  if (flags != 0 && flags != 2)
    return 1;
  *event = calloc(1, sizeof(FakeEvent));
  ++tai_fake_cuda_events;
  return 0;
}
Result cuEventDestroy_v2(void *event) {
  --tai_fake_cuda_events;
  free(event);
  return 0;
}
/// While a graph is recorded.
NOT_COUNTED static int isRecording(void);
NOT_COUNTED static Result branch(void *given, void *on);
/// The waits of streams for others: "a>b " for b, which waits for a, ours being
/// 's'.
char tai_fake_cuda_waits[256];
NOT_COUNTED static char letter(void *given) {
  return given == &stream ? 's' : (char)('0' + (char)(uintptr_t)given);
}
Result cuStreamWaitEvent(void *given, void *event, unsigned flags) {
  FakeEvent *fake = event;
  if (flags || !fake->recorded)
    return 1;
  if (isRecording())
    return branch(given, fake->on);
  size_t used = strlen(tai_fake_cuda_waits);
  snprintf(tai_fake_cuda_waits + used, sizeof(tai_fake_cuda_waits) - used,
           "%c>%c ", letter(fake->on), letter(given));
  return 0;
}
Result cuEventRecord(void *event, void *on) {
  FakeEvent *fake = event;
  fake->on = on;
  fake->time = now;
  fake->recorded = 1;
  return 0;
}
/// Waiting for one is waiting for all before it.
static long long reached;
Result cuEventSynchronize(void *event) {
  FakeEvent *fake = event;
  if (!fake->recorded)
    return 400;
  if (fake->time > reached)
    reached = fake->time;
  return faulted ? 700 : 0;
}

Result cuEventQuery(void *event) {
  return isRunning(((FakeEvent *)event)->on) ? NotReady
                                             : cuEventSynchronize(event);
}
Result cuEventElapsedTime(float *ms, void *from, void *to) {
  FakeEvent *a = from, *b = to;
  if (!a->recorded || !b->recorded)
    return 400;
  if (a->time > reached || b->time > reached)
    return NotReady;
  *ms = (float)(b->time - a->time) / 1000;
  return 0;
}

/// The size stands in front of the memory.
NOT_COUNTED static Result allocate(Address *result, size_t bytes) {
  if (taken + bytes > total())
    return 2;
  char *memory = malloc(bytes + 64);
  if (!memory)
    return 2;
  memcpy(memory, &bytes, sizeof(bytes));
  memset(memory + 64, 0xa5, bytes);
  taken += bytes;
  *result = (Address)(uintptr_t)(memory + 64);
  return 0;
}
NOT_COUNTED static Result release(Address address) {
  char *memory = (char *)(uintptr_t)address - 64;
  size_t bytes;
  memcpy(&bytes, memory, sizeof(bytes));
  taken -= bytes;
  free(memory);
  return 0;
}
Result cuMemAllocManaged(Address *result, size_t bytes, unsigned flags) {
  Result failed = flags != 1 ? 1 : allocate(result, bytes);
  if (!failed)
    memset((void *)*result, 0, bytes);
  return failed;
}
Result cuMemAlloc_v2(Address *result, size_t bytes) {
  return allocate(result, bytes);
}
Result cuMemFree_v2(Address address) { return release(address); }
Result cuMemPoolCreate(void **pool, const void *properties) {
  (void)properties;
  *pool = &taken;
  return 0;
}
Result cuMemPoolDestroy(void *pool) {
  (void)pool;
  return 0;
}
Result cuMemPoolSetAttribute(void *pool, int attribute, void *value) {
  (void)pool, (void)attribute, (void)value;
  return 0;
}
Result cuMemPoolTrimTo(void *pool, size_t bytes) {
  (void)pool, (void)bytes;
  return 0;
}
Result cuMemAllocFromPoolAsync(Address *result, size_t bytes, void *pool,
                               void *on) {
  (void)on;
  // A device without pools has none to allocate from.
  return pool && !has("no-pools") ? allocate(result, bytes) : 801;
}
Result cuMemFreeAsync(Address address, void *on) {
  (void)on;
  return has("no-pools") ? 801 : release(address);
}
Result cuMemAllocHost_v2(void **result, size_t bytes) {
  *result = malloc(bytes);
  return *result ? 0 : 2;
}
Result cuMemFreeHost(void *memory) {
  free(memory);
  return 0;
}

Result cuMemcpyHtoDAsync_v2(Address to, const void *from, size_t bytes,
                            void *on) {
  if (bytes == sizeof(late.word) && isRunning(on)) {
    late.to = (void *)(uintptr_t)to;
    memcpy(&late.word, from, bytes);
    return 0;
  }
  memcpy((void *)(uintptr_t)to, from, bytes);
  return 0;
}
Result cuMemcpyDtoHAsync_v2(void *to, Address from, size_t bytes, void *on) {
  (void)on;
  memcpy(to, (const void *)(uintptr_t)from, bytes);
  return 0;
}
NOT_COUNTED static Result submit(const FakeNode *node);
/// Where work is queued.
static void *target;
Result cuMemcpyDtoDAsync_v2(Address to, Address from, size_t bytes, void *on) {
  target = on;
  FakeNode node = {.kind = 1, .values = {to, from, bytes}};
  return submit(&node);
}
NOT_COUNTED static Result fill(Address to, unsigned value, size_t count,
                               unsigned bytes) {
  FakeNode node = {.kind = 2, .values = {to, value, count, bytes}};
  return submit(&node);
}
/// Fills of bytes by the driver, which refuses memory of two allocations.
int tai_fake_cuda_memsets;
Result cuMemsetD8Async(Address to, unsigned char value, size_t count,
                       void *on) {
  target = on;
  ++tai_fake_cuda_memsets;
  return fill(to, value, count, 1);
}
Result cuMemsetD16Async(Address to, unsigned short value, size_t count,
                        void *on) {
  target = on;
  return fill(to, value, count, 2);
}
Result cuMemsetD32Async(Address to, unsigned value, size_t count, void *on) {
  target = on;
  return fill(to, value, count, 4);
}
Result cuPointerGetAttribute(void *value, int attribute, Address address) {
  (void)value, (void)attribute, (void)address;
  return 1; // no memory that the driver knows
}

NOT_COUNTED static void keepImage(const char *image) {
  static int number;
  const char *folder = getenv("TAI_FAKE_CUDA_IMAGES");
  char path[4096];
  if (!folder)
    return;
  snprintf(path, sizeof(path), "%s/%03d.ptx", folder, number++);
  FILE *file = fopen(path, "w");
  if (!file)
    return;
  fputs(image, file);
  fclose(file);
}
Result cuModuleLoadDataEx(void **result, const void *image, unsigned count,
                          int *options, void **values) {
  keepImage(image);
  if (has("bad-ptx")) {
    for (unsigned i = 0; i < count; ++i)
      if (options[i] == 5)
        strcpy(values[i], "ptxas fatal : line 3: unknown instruction\n");
    return 218;
  }
  *result = strncmp(image, "//", 2) == 0 ? &module : NULL;
  return *result ? 0 : 218;
}
/// Linking keeps the text, which then stands for machine code.
struct Link {
  char *text;
};
Result cuLinkCreate_v2(unsigned count, int *options, void **values,
                       void **result) {
  (void)count, (void)options, (void)values;
  *result = calloc(1, sizeof(struct Link));
  return *result ? 0 : 2;
}
Result cuLinkAddData_v2(void *given, int kind, void *data, size_t bytes,
                        const char *name, unsigned count, int *options,
                        void **values) {
  (void)kind, (void)name, (void)count, (void)options, (void)values;
  if (has("bad-ptx"))
    return 218;
  struct Link *link = given;
  link->text = calloc(1, bytes + 1);
  memcpy(link->text, data, bytes);
  return 0;
}
Result cuLinkComplete(void *given, void **result, size_t *bytes) {
  struct Link *link = given;
  *result = link->text;
  *bytes = strlen(link->text);
  return 0;
}
Result cuLinkDestroy(void *given) {
  free(((struct Link *)given)->text);
  free(given);
  return 0;
}
Result cuModuleUnload(void *given) {
  (void)given;
  return 0;
}
Result cuModuleGetFunction(void **result, void *given, const char *name) {
  (void)given;
  static char names[][16] = {"scale",          "add",
                             "where",          "until",
                             "tai_copy_quads",
                             "tai_copy_pairs", "tai_copy_words",
                             "tai_copy_bytes", "tai_swap_quads",
                             "tai_swap_pairs", "tai_swap_words",
                             "tai_swap_bytes", "tai_fill_pieces"};
  for (unsigned i = 0; i < sizeof(names) / sizeof(names[0]); ++i)
    if (strcmp(name, names[i]) == 0) {
      *result = names[i];
      return 0;
    }
  static char nothing[] = "nothing";
  *result = nothing;
  return has("any-function") ? 0 : 500;
}
Result cuFuncGetAttribute(int *value, int attribute, void *function) {
  (void)function;
  // Threads; bytes: shared, constant, local; registers.
  static const int values[] = {512, 1024, 64, 16, 40};
  if (attribute < 0 || attribute > 4)
    return 1;
  *value = values[attribute];
  return 0;
}
Result cuOccupancyMaxActiveBlocksPerMultiprocessor(int *blocks, void *function,
                                                   int threads, size_t shared) {
  (void)function, (void)shared;
  *blocks = 2048 / threads;
  return 0;
}

/// As Rows.cu has them.
NOT_COUNTED static void rows(const char *function, void **parameters) {
  uint64_t p[6];
  for (int i = 0; i < 6; ++i)
    p[i] = *(uint64_t *)parameters[i];
  size_t unit = strstr(function, "quads")   ? 16
                : strstr(function, "pairs") ? 8
                : strstr(function, "words") ? 4
                                            : 1;
  for (uint64_t row = 0; row < p[5]; ++row) {
    char *a = (char *)(uintptr_t)p[0] + row * p[1] * unit;
    char *b = (char *)(uintptr_t)p[2] + row * p[3] * unit;
    for (size_t byte = 0; byte < p[4] * unit; ++byte) {
      char before = a[byte];
      a[byte] = b[byte];
      if (strstr(function, "swap"))
        b[byte] = before;
    }
  }
}

NOT_COUNTED static Result perform(const FakeNode *node) {
  const uint64_t *v = node->values;
  if (node->kind == 1) {
    memmove((void *)v[0], (const void *)v[1], v[2]);
    return 0;
  }
  if (node->kind == 2) {
    for (size_t i = 0; i < v[2]; ++i)
      memcpy((char *)v[0] + i * v[3], &v[1], v[3]);
    return 0;
  }
  const char *function = node->function;
  uint64_t values[mostValues];
  void *parameters[mostValues];
  memcpy(values, v, sizeof(values));
  for (int i = 0; i < mostValues; ++i)
    parameters[i] = &values[i];
  now += !has("likes-512") ? 1 : node->threads == 512 ? 400 : 900;
  if (has("fault"))
    faulted = 1;
  else if (strcmp(function, "scale") == 0 || strcmp(function, "add") == 0) {
    double *x = (double *)v[0], by;
    int64_t n = (int64_t)v[1];
    memcpy(&by, &v[2], sizeof(by));
    now += n / 1000;
    for (int64_t i = 0; i < n; ++i)
      x[i] = *function == 's' ? x[i] * by : x[i] + by;
  } else if (strcmp(function, "tai_fill_pieces") == 0) {
    // The last block first, to find out who counts on an order.
    for (unsigned block = node->blocks; block-- > 0;)
      for (unsigned thread = 0; thread < node->threads; ++thread)
        taiFillAll((const TaiFillTable *)v, block, node->blocks, thread);
  } else if (strncmp(function, "tai_", 4) == 0) {
    rows(function, parameters);
  } else if (strcmp(function, "where") == 0) {
    int32_t *result = (int32_t *)v[0];
    result[0] = (int32_t)node->blocks;
    result[1] = (int32_t)node->threads;
  } else if (strcmp(function, "until") == 0) {
    awaited = (volatile uint32_t *)v[0];
  }
  return 0;
}

/// The graph that is being recorded; null for none.
static FakeGraph *recording;
/// How often the driver was asked for work on the device, and to record or
/// change some.
int tai_fake_cuda_submissions, tai_fake_cuda_records, tai_fake_cuda_changes;

/// The work of the other stream while a graph is recorded: it comes as late as
/// it may, or with the word "side-first" as early. `branches` is 1 where
/// nothing waits for it yet.
static FakeGraph *beside;
static int branches;

NOT_COUNTED static int isRecording(void) { return recording != NULL; }
NOT_COUNTED static Result branch(void *given, void *on) {
  if (given == &side && on == &stream && !branches) {
    branches = 1;
    beside->count = 0;
    return 0;
  }
  if (given != &stream || on != &side || !branches)
    return 900;
  branches = 0;
  for (int i = 0; i < beside->count; ++i)
    recording->nodes[recording->count++] = beside->nodes[i];
  return 0;
}
NOT_COUNTED static Result submit(const FakeNode *node) {
  if (!recording) {
    ++tai_fake_cuda_submissions;
    return perform(node);
  }
  FakeGraph *graph = target == &side && !has("side-first") ? beside : recording;
  if (target == &side && !branches)
    return 900;
  if (graph->count == mostNodes)
    return 2;
  graph->nodes[graph->count++] = *node;
  return 0;
}
/// The last fill by a kernel.
TaiFillTable tai_fake_cuda_fills;

NOT_COUNTED static void setLaunch(FakeNode *node, const char *function,
                                  unsigned blocks, unsigned threads,
                                  void **parameters) {
  int count = strcmp(function, "scale") == 0 || strcmp(function, "add") == 0 ? 3
              : strcmp(function, "where") == 0                               ? 1
              : strcmp(function, "until") == 0                               ? 1
              : strncmp(function, "tai_", 4) == 0 ? 6
                                                  : 0;
  node->kind = 0;
  node->function = function;
  node->blocks = blocks;
  node->threads = threads;
  if (strcmp(function, "tai_fill_pieces") == 0) {
    memcpy(node->values, parameters[0], sizeof(TaiFillTable));
    memcpy(&tai_fake_cuda_fills, parameters[0], sizeof(TaiFillTable));
  }
  for (int i = 0; i < count; ++i)
    node->values[i] = *(uint64_t *)parameters[i];
}
NOT_COUNTED static Result launch(const char *function, unsigned blocks,
                                 unsigned threads, int overlaps,
                                 void **parameters) {
  if (current != &context)
    return 201;
  FakeNode node = {.overlaps = overlaps};
  setLaunch(&node, function, blocks, threads, parameters);
  return submit(&node);
}
/// The threads of a block of the last launch.
int tai_fake_cuda_threads;
enum { LaunchOutOfResources = 701 };
Result cuLaunchKernel(void *function, unsigned blocks, unsigned by, unsigned bz,
                      unsigned threads, unsigned ty, unsigned tz,
                      unsigned shared, void *on, void **parameters,
                      void **extra) {
  (void)by, (void)bz, (void)ty, (void)tz, (void)shared, (void)extra;
  target = on;
  if (has("small-blocks") && threads > 64)
    return LaunchOutOfResources;
  tai_fake_cuda_threads = (int)threads;
  return launch(function, blocks, threads, 0, parameters);
}
Result cuLaunchCooperativeKernel(void *function, unsigned blocks, unsigned by,
                                 unsigned bz, unsigned threads, unsigned ty,
                                 unsigned tz, unsigned shared, void *on,
                                 void **parameters) {
  (void)by, (void)bz, (void)ty, (void)tz, (void)shared;
  target = on;
  return launch(function, blocks, threads, 0, parameters);
}

/* Clusters of kernels that do nothing. */
enum { NotSupported = 801, OverlapAttribute = 6 };
Result cuFuncSetAttribute(void *function, int attribute, int value) {
  (void)function, (void)attribute, (void)value;
  return has("overlaps") ? 0 : NotSupported;
}
typedef struct {
  unsigned kind, unused, values[16];
} LaunchAttribute;
typedef struct {
  unsigned grid[3], block[3], shared;
  void *on;
  LaunchAttribute *attributes;
  unsigned count;
} LaunchConfiguration;
Result cuLaunchKernelEx(const LaunchConfiguration *how, void *function,
                        void **parameters, void **extra) {
  (void)extra;
  if (!has("overlaps"))
    return NotSupported;
  target = how->on;
  return launch(function, how->grid[0], how->block[0],
                how->count > 0 && how->attributes[0].kind == OverlapAttribute,
                parameters);
}
Result cuStreamBeginCapture_v2(void *given, int mode) {
  (void)given, (void)mode;
  if (has("no-graphs"))
    return NotSupported;
  ++tai_fake_cuda_records;
  recording = calloc(1, sizeof(FakeGraph));
  if (!beside)
    beside = calloc(1, sizeof(FakeGraph));
  branches = 0;
  return recording && beside ? 0 : 2;
}
/// Counts of the last recording: all pieces of work, and those that may start
/// while the one before them runs.
int tai_fake_cuda_nodes, tai_fake_cuda_overlapping;
Result cuStreamEndCapture(void *given, void **graph) {
  (void)given;
  tai_fake_cuda_nodes = recording ? recording->count : 0;
  tai_fake_cuda_overlapping = 0;
  for (int i = 0; i < tai_fake_cuda_nodes; ++i)
    tai_fake_cuda_overlapping += recording->nodes[i].overlaps;
  *graph = recording;
  recording = NULL;
  if (branches)
    return 904; // a branch is open
  return *graph ? 0 : 401;
}
/// Graphs that are ready to run.
int tai_fake_cuda_graphs;

/// Later uses find the graph empty.
NOT_COUNTED static void forget(FakeGraph *graph) {
  memset(graph->nodes, 0, (size_t)graph->count * sizeof(FakeNode));
  graph->count = 0;
  free(graph);
}
/// A line for each piece of work, on standard error.
NOT_COUNTED static void list(const FakeGraph *graph) {
  fprintf(stderr, "graph of %d:\n", graph->count);
  for (int i = 0; i < graph->count; ++i) {
    const FakeNode *node = &graph->nodes[i];
    const uint64_t *v = node->values;
    if (node->kind == 0)
      fprintf(stderr, "  %s %u x %u%s\n", node->function, node->blocks,
              node->threads, node->overlaps ? ", overlaps" : "");
    const TaiFillTable *table = (const TaiFillTable *)v;
    if (node->kind == 0 && strcmp(node->function, "tai_fill_pieces") == 0)
      for (uint64_t e = 0; e < table->count; ++e)
        fprintf(stderr,
                "    %llx: %llu units of %d, rows of %llu, %llu tiles\n",
                table->entries[e].address, table->entries[e].units,
                table->entries[e].unitBytes, table->entries[e].rowUnits,
                table->entries[e].end);
    if (node->kind != 0)
      fprintf(stderr, "  %s %llx, %llu bytes\n",
              node->kind == 1 ? "copy" : "fill", (unsigned long long)v[0],
              (unsigned long long)(node->kind == 1 ? v[2] : v[2] * v[3]));
  }
}

Result cuGraphCreate(void **result, unsigned flags) {
  (void)flags;
  if (has("no-graphs"))
    return NotSupported;
  *result = calloc(1, sizeof(FakeGraph));
  return *result ? 0 : 2;
}
typedef struct {
  const char *function;
  unsigned grid[3], block[3], shared;
  void **values, **extra;
} KernelParameters;
Result cuGraphAddKernelNode(void **result, void *given, void *const *before,
                            size_t count, const KernelParameters *p) {
  (void)before, (void)count;
  FakeGraph *graph = given;
  if (graph->count == mostNodes)
    return 1;
  FakeNode *node = &graph->nodes[graph->count++];
  setLaunch(node, p->function, p->grid[0], p->block[0], p->values);
  *result = node;
  return 0;
}
Result cuGraphInstantiateWithFlags(void **result, void *given,
                                   unsigned long long flags) {
  (void)flags;
  FakeGraph *graph = given, *made = calloc(1, sizeof(FakeGraph));
  if (!made)
    return 2;
  made->count = graph->count;
  memcpy(made->nodes, graph->nodes, (size_t)graph->count * sizeof(FakeNode));
  made->origin = graph;
  if (has("list-graphs"))
    list(graph);
  *result = made;
  ++tai_fake_cuda_graphs;
  return 0;
}
/// The same pieces of work with other parameters.
Result cuGraphExecUpdate_v2(void *given, void *other, void *update) {
  (void)update;
  FakeGraph *executable = given, *graph = other;
  int isSame = executable->count == graph->count;
  for (int i = 0; isSame && i < graph->count; ++i)
    isSame = executable->nodes[i].kind == graph->nodes[i].kind &&
             executable->nodes[i].function == graph->nodes[i].function;
  if (!isSame)
    return 910;
  memcpy(executable->nodes, graph->nodes,
         (size_t)graph->count * sizeof(FakeNode));
  return 0;
}
Result cuGraphLaunch(void *given, void *on) {
  (void)on;
  // As the driver does, which says nothing.
  if (current != &context)
    __builtin_trap();
  FakeGraph *executable = given;
  ++tai_fake_cuda_submissions;
  for (int i = 0; i < executable->count; ++i)
    perform(&executable->nodes[i]);
  return 0;
}
Result cuGraphDestroy(void *graph) {
  forget(graph);
  return 0;
}
Result cuGraphExecDestroy(void *executable) {
  forget(executable);
  --tai_fake_cuda_graphs;
  return 0;
}
Result cuGraphGetRootNodes(void *given, void **nodes, size_t *count) {
  FakeGraph *graph = given;
  *count = graph->count > 0;
  if (nodes && *count)
    nodes[0] = &graph->nodes[0];
  return 0;
}
/// The next one, if there is one.
Result cuGraphNodeGetDependentNodes(void *given, void **nodes, size_t *count) {
  FakeNode *next = (FakeNode *)given + 1;
  *count = next->function || next->kind;
  if (nodes && *count)
    nodes[0] = next;
  return 0;
}
Result cuGraphNodeGetType(void *node, int *type) {
  *type = ((FakeNode *)node)->kind;
  return 0;
}
Result cuGraphExecKernelNodeSetParams(void *given, void *node,
                                      const void *parameters) {
  FakeGraph *executable = given;
  const KernelParameters *p = parameters;
  // Nodes are those of the graph that it was made from.
  if (has("fixed-graphs"))
    return NotSupported;
  ptrdiff_t number = (FakeNode *)node - executable->origin->nodes;
  if (number < 0 || number >= executable->count ||
      executable->nodes[number].function != p->function)
    return 1;
  ++tai_fake_cuda_changes;
  setLaunch(&executable->nodes[number], p->function, p->grid[0], p->block[0],
            p->values);
  return 0;
}
Result cuDevicePrimaryCtxReset_v2(int device) {
  (void)device;
  return 0;
}
static size_t heap = 8 << 20;
Result cuCtxSetLimit(int limit, size_t value) {
  if (limit != 2 || has("heap-in-use"))
    return 1;
  heap = value;
  return 0;
}
Result cuCtxGetLimit(size_t *value, int limit) {
  *value = heap;
  return limit == 2 ? 0 : 1;
}
