//===- DriverLaunch.c - The cost of a launch in the driver ----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Queues launches of a small kernel by each of the driver's interfaces, and
// prints nanoseconds for each: the minimum of many batches, and their median.
// This is the lower bound of a launch from Python.
//
//   cc -std=gnu17 -O2 -pthread DriverLaunch.c -ldl && ./a.out
//
// TAI_CUDA_DRIVER names another library than libcuda.so.1.
//
//===----------------------------------------------------------------------===//

#define _GNU_SOURCE
#include <dlfcn.h>
#include <pthread.h>
#include <sched.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

typedef void *Handle;
enum { Batches = 60, Most = 1000 };

static void *library;
static void *find(const char *name) { return dlsym(library, name); }
static void must(int result, const char *what) {
  if (result) {
    fprintf(stderr, "%s: error %d\n", what, result);
    exit(1);
  }
}
#define CALL(name, ...) must(((int (*)())find(name))(__VA_ARGS__), name)

static int (*launchKernel)(Handle, unsigned, unsigned, unsigned, unsigned,
                           unsigned, unsigned, unsigned, Handle, void **,
                           void **);
static int (*getCurrent)(Handle *);
static int (*launchKernelEx)(const void *, Handle, void **, void **);
static int (*launchGraph)(Handle, Handle);
static int (*setNode)(Handle, Handle, const void *);

static const char text[] =
    "//\n.version 7.0\n.target sm_70\n.address_size 64\n"
    ".visible .entry bump(.param .u64 p, .param .u32 t) {\n"
    "  .reg .b64 %rd<3>; .reg .b32 %r<2>; .reg .f32 %f<4>;\n"
    "  ld.param.u64 %rd1, [p]; ld.param.u32 %r1, [t];\n"
    "  cvta.to.global.u64 %rd2, %rd1; ld.global.f32 %f1, [%rd2];\n"
    "  cvt.rn.f32.s32 %f2, %r1; add.f32 %f3, %f1, %f2;\n"
    "  st.global.f32 [%rd2], %f3; ret;\n}\n"
    ".visible .entry none() { ret; }\n"
    ".visible .entry many(.param .u64 a, .param .u64 b, .param .u64 c,\n"
    "  .param .u64 d, .param .u64 e, .param .u64 f, .param .u64 g,\n"
    "  .param .u64 h, .param .u64 i, .param .u64 j, .param .u64 k,\n"
    "  .param .u64 l, .param .u64 m, .param .u64 n, .param .u64 o,\n"
    "  .param .u64 q) { ret; }\n";

/// The launched function, and its arguments.
static Handle function, stream, graph;
static void *parameters[16], *extra[5];
static uint64_t values[16];
static int batch = 200;

static void plain(void) {
  must(launchKernel(function, 1, 1, 1, 1, 1, 1, 0, stream, parameters, NULL),
       "cuLaunchKernel");
}
static void withContext(void) {
  Handle current;
  must(getCurrent(&current), "cuCtxGetCurrent");
  plain();
}
static void withExtra(void) {
  must(launchKernel(function, 1, 1, 1, 1, 1, 1, 0, stream, NULL, extra),
       "cuLaunchKernel");
}
static void withConfiguration(void) {
  struct {
    unsigned grid[3], block[3], shared;
    Handle stream, attributes;
    unsigned count;
  } configuration = {{1, 1, 1}, {1, 1, 1}, 0, stream, NULL, 0};
  must(launchKernelEx(&configuration, function, parameters, NULL),
       "cuLaunchKernelEx");
}

static long long now(void) {
  struct timespec time;
  clock_gettime(CLOCK_MONOTONIC, &time);
  return (long long)time.tv_sec * 1000000000 + time.tv_nsec;
}
static int compare(const void *a, const void *b) {
  double difference = *(const double *)a - *(const double *)b;
  return difference < 0 ? -1 : difference > 0;
}
/// Measures `work`, which queues `launches` launches.
static double measure(const char *what, void (*work)(void), int times,
                      int launches) {
  double ns[Batches];
  for (int i = -5; i < Batches; ++i) {
    long long start = now();
    for (int k = 0; k < times; ++k)
      work();
    double each = (double)(now() - start) / launches;
    if (i >= 0)
      ns[i] = each;
    CALL("cuStreamSynchronize", stream);
  }
  qsort(ns, Batches, sizeof(*ns), compare);
  if (what)
    printf("%-52s %8.0f %8.0f\n", what, ns[0], ns[Batches / 2]);
  return ns[Batches / 2];
}
static void report(const char *what, void (*work)(void)) {
  (void)measure(what, work, batch, batch);
}

//===----------------------------------------------------------------------===//
// Graphs
//===----------------------------------------------------------------------===//

static Handle executable, nodes[Most];
static size_t numNodes;
static void runGraph(void) { must(launchGraph(executable, stream), "graph"); }
static void patchGraph(void) {
  struct {
    Handle function;
    unsigned grid[3], block[3], shared;
    void **parameters, **extra;
    Handle kernel, context;
  } node = {function, {1, 1, 1}, {1, 1, 1}, 0, parameters, NULL, NULL, NULL};
  for (size_t i = 0; i < numNodes; ++i)
    must(setNode(executable, nodes[i], &node),
         "cuGraphExecKernelNodeSetParams");
  runGraph();
}
static void measureGraph(int length) {
  int (*begin)(Handle, int) = find("cuStreamBeginCapture_v2");
  if (!begin || begin(stream, 1)) {
    printf("no graphs\n");
    return;
  }
  for (int i = 0; i < length; ++i)
    plain();
  CALL("cuStreamEndCapture", stream, &graph);
  CALL("cuGraphInstantiateWithFlags", &executable, graph, 0ull);
  numNodes = Most;
  CALL("cuGraphGetNodes", graph, nodes, &numNodes);
  char what[64];
  snprintf(what, sizeof(what), "graph of %d, each launch", length);
  (void)measure(what, runGraph, 200 / length, 200 / length * length);
  snprintf(what, sizeof(what), "graph of %d with new parameters", length);
  if (setNode)
    (void)measure(what, patchGraph, 200 / length, 200 / length * length);
  CALL("cuGraphExecDestroy", executable);
  CALL("cuGraphDestroy", graph);
}

//===----------------------------------------------------------------------===//
// Another thread that launches
//===----------------------------------------------------------------------===//

enum { Room = 4096 };
static struct {
  Handle function;
  uint64_t values[2];
} ring[Room];
static uint64_t put __attribute__((aligned(64))),
    taken __attribute__((aligned(64)));
static Handle context;
static int stops;

static void *launchAll(void *unused) {
  CALL("cuCtxSetCurrent", context);
  for (uint64_t at = 0;;) {
    while (__atomic_load_n(&put, __ATOMIC_ACQUIRE) == at)
      if (__atomic_load_n(&stops, __ATOMIC_RELAXED))
        return unused;
    uint64_t *given = ring[at % Room].values;
    void *these[] = {&given[0], &given[1]};
    must(launchKernel(ring[at % Room].function, 1, 1, 1, 1, 1, 1, 0, stream,
                      these, NULL),
         "cuLaunchKernel");
    __atomic_store_n(&taken, ++at, __ATOMIC_RELEASE);
  }
}
static void handOver(void) {
  while (put - __atomic_load_n(&taken, __ATOMIC_ACQUIRE) == Room)
    ;
  ring[put % Room].function = function;
  memcpy(ring[put % Room].values, values, sizeof(ring->values));
  __atomic_store_n(&put, put + 1, __ATOMIC_RELEASE);
}
static void handOverAll(void) {
  for (int i = 0; i < batch; ++i)
    handOver();
  while (__atomic_load_n(&taken, __ATOMIC_ACQUIRE) != put)
    ;
}
static void measureThread(void) {
  pthread_t thread;
  if (pthread_create(&thread, NULL, launchAll, NULL))
    return;
  report("handed to a thread that spins", handOver);
  (void)measure("the same, until it has launched all", handOverAll, 1, batch);
  __atomic_store_n(&stops, 1, __ATOMIC_RELAXED);
  pthread_join(thread, NULL);
}

/// The driver writes to the device, from which some cores are farther away.
static void measureCores(void) {
  cpu_set_t before;
  if (sched_getaffinity(0, sizeof(before), &before))
    return;
  double least = 1e9, most = 0;
  int best = -1, worst = -1;
  for (int core = 0; core < CPU_SETSIZE; ++core) {
    if (!CPU_ISSET(core, &before))
      continue;
    cpu_set_t only;
    CPU_ZERO(&only);
    CPU_SET(core, &only);
    if (sched_setaffinity(0, sizeof(only), &only))
      continue;
    double ns = measure(NULL, plain, batch, batch);
    if (ns < least)
      least = ns, best = core;
    if (ns > most)
      most = ns, worst = core;
  }
  (void)sched_setaffinity(0, sizeof(before), &before);
  printf("medians by core: %.0f on core %d to %.0f on core %d\n", least, best,
         most, worst);
}

int main(void) {
  const char *given = getenv("TAI_CUDA_DRIVER");
  library = dlopen(given && *given ? given : "libcuda.so.1", RTLD_NOW);
  if (!library) {
    fprintf(stderr, "%s\n", dlerror());
    return 1;
  }
  launchKernel = find("cuLaunchKernel");
  launchKernelEx = find("cuLaunchKernelEx");
  getCurrent = find("cuCtxGetCurrent");
  launchGraph = find("cuGraphLaunch");
  setNode = find("cuGraphExecKernelNodeSetParams_v2");
  int device;
  CALL("cuInit", 0);
  CALL("cuDeviceGet", &device, 0);
  CALL("cuDevicePrimaryCtxRetain", &context, device);
  CALL("cuCtxSetCurrent", context);
  Handle module, bump, none, many, ordered, loose;
  CALL("cuModuleLoadDataEx", &module, text, 0, NULL, NULL);
  CALL("cuModuleGetFunction", &bump, module, "bump");
  CALL("cuModuleGetFunction", &none, module, "none");
  CALL("cuModuleGetFunction", &many, module, "many");
  CALL("cuStreamCreate", &ordered, 0);
  CALL("cuStreamCreate", &loose, 1);
  CALL("cuMemAlloc_v2", &values[0], (size_t)4096);
  values[1] = 1;
  for (int i = 0; i < 16; ++i)
    parameters[i] = &values[i];
  static size_t bytes = 12;
  extra[0] = (void *)1, extra[1] = values, extra[2] = (void *)2;
  extra[3] = &bytes;

  printf("%-52s %8s %8s\n", "ns for each launch", "least", "median");
  stream = ordered, function = bump;
  report("in order with the default stream, as tai does", plain);
  report("after asking for the context", withContext);
  report("parameters in one buffer", withExtra);
  if (launchKernelEx && !(given && *given))
    report("cuLaunchKernelEx", withConfiguration);
  function = none;
  report("without parameters", plain);
  function = many;
  report("with 16 parameters", plain);
  function = bump;
  stream = loose;
  report("on a stream that waits for no other", plain);
  stream = NULL;
  report("on the default stream", plain);
  stream = (Handle)2;
  report("on the default stream of the thread", plain);
  stream = ordered;
  static const int sizes[] = {10, 50, 1000};
  for (int i = 0; i < 3; ++i) {
    char what[64];
    batch = sizes[i];
    snprintf(what, sizeof(what), "%d at a time, not 200", batch);
    report(what, plain);
  }
  batch = 200;
  static const int lengths[] = {1, 8, 40, 200};
  for (int i = 0; i < 4; ++i)
    measureGraph(lengths[i]);
  measureThread();
  measureCores();
  report("in order with the default stream, again", plain);
  if (!((int (*)(int, size_t))find("cuCtxSetLimit"))(2, (size_t)4 << 30))
    report("with a heap of 4 GiB", plain);
  return 0;
}
