//===- Driver.h - The functions of the CUDA driver --------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The part of the binary interface of libcuda.so.1 that the runtime uses. The
// library exists only on machines with a GPU, and is loaded when a device is
// opened, so that neither building nor running on the CPU needs any part of
// CUDA.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_CUDA_DRIVER_H
#define TAI_LIB_RUNTIME_CUDA_DRIVER_H

#include "tai/Support/Status.h"
#include <cstddef>
#include <cstdint>

namespace mlir::tai::runtime::cuda {

using Result = int;
using DeviceNumber = int;
using Address = unsigned long long;
using Context = struct ContextStruct *;
using Stream = struct StreamStruct *;
using Module = struct ModuleStruct *;
using Function = struct FunctionStruct *;
using Pool = struct PoolStruct *;
using Event = struct EventStruct *;
using Graph = struct GraphStruct *;
using ExecutableGraph = struct ExecutableGraphStruct *;
using Node = struct NodeStruct *;
using LinkState = struct LinkStateStruct *;

// Results.
constexpr Result kSuccess = 0;
constexpr Result kNotReady = 600;
constexpr Result kInvalidValue = 1;
constexpr Result kOutOfMemory = 2;
constexpr Result kDeinitialized = 4;
constexpr Result kNoDevice = 100;
constexpr Result kInvalidPtx = 218;
constexpr Result kUnsupportedPtxVersion = 222;
// Error codes after a kernel has accessed memory out of range.
constexpr Result kIllegalAddress = 700;
constexpr Result kLaunchOutOfResources = 701;
constexpr Result kHardwareStackError = 714;
constexpr Result kIllegalInstruction = 715;
constexpr Result kMisalignedAddress = 716;
constexpr Result kInvalidAddressSpace = 717;
constexpr Result kInvalidPc = 718;
constexpr Result kLaunchFailed = 719;

// Attributes of devices.
constexpr int kMaxThreadsPerBlock = 1;
constexpr int kMultiprocessorCount = 16;
constexpr int kMaxThreadsPerMultiprocessor = 39;
constexpr int kCooperativeLaunch = 95;
constexpr int kClusterLaunch = 120;
constexpr int kCapabilityMajor = 75;
constexpr int kCapabilityMinor = 76;
constexpr int kMemoryPools = 115;
constexpr int kConcurrentManagedAccess = 89;
// Limits.
constexpr int kLimitHeapBytes = 2;
// Attributes of functions.
constexpr int kFunctionMaxThreads = 0;
constexpr int kFunctionSharedBytes = 1;
constexpr int kFunctionConstantBytes = 2;
constexpr int kFunctionLocalBytes = 3;
constexpr int kFunctionRegisters = 4;
constexpr int kFunctionAnyCluster = 14;
// Attributes of launches.
constexpr unsigned kLaunchCooperative = 2;
constexpr unsigned kLaunchCluster = 4;
constexpr unsigned kLaunchOverlapped = 6;
// The capture mode in which a graph capture does not restrict calls of other
// threads.
constexpr int kCaptureThreadLocal = 1;
// Kinds of nodes of graphs.
constexpr int kNodeKernel = 0;
// The flag of streams that have no implicit order with the default stream.
constexpr unsigned kStreamNonBlocking = 1;
// Flags of events.
constexpr unsigned kEventDefault = 0;
constexpr unsigned kEventNoTiming = 2;
// The legacy default stream, which synchronises with all blocking streams.
constexpr uintptr_t kLegacyStream = 1;
// Attributes of pools.
constexpr int kPoolReleaseThreshold = 4;
// The flag of managed memory that is accessible from all streams.
constexpr unsigned kAttachGlobal = 1;
// Attributes of addresses, and types of memory, as the driver numbers them.
constexpr int kAddressMemoryType = 2;
constexpr unsigned kMemoryTypeDevice = 2;
constexpr unsigned kMemoryTypeUnified = 4;
// Options of the PTX compiler.
constexpr int kJitInfoBuffer = 3;
constexpr int kJitInfoBytes = 4;
constexpr int kJitErrorBuffer = 5;
constexpr int kJitErrorBytes = 6;
constexpr int kJitInputPtx = 1;

struct PoolProperties {
  int allocationType = 1; // pinned, which is to say: on a device
  int handleTypes = 0;
  int locationType = 1; // a device
  int locationId = 0;
  void *securityAttributes = nullptr;
  size_t maxBytes = 0;
  unsigned char reserved[56] = {};
};
static_assert(sizeof(PoolProperties) == 88, "the layout is the driver's");

struct LaunchAttribute {
  unsigned kind;
  unsigned unused = 0;
  unsigned values[16] = {};
};
static_assert(sizeof(LaunchAttribute) == 72, "the layout is the driver's");

struct LaunchConfiguration {
  unsigned grid[3];
  unsigned block[3];
  unsigned sharedBytes;
  Stream stream;
  LaunchAttribute *attributes;
  unsigned numAttributes;
};
static_assert(sizeof(LaunchConfiguration) == 56, "the layout is the driver's");

/// Why an executable graph could not be updated (CUgraphExecUpdateResultInfo).
struct GraphUpdate {
  int result = 0;
  void *node = nullptr;
  void *from = nullptr;
};

/// A kernel node of a graph (CUDA_KERNEL_NODE_PARAMS).
struct KernelNodeParameters {
  Function function;
  unsigned grid[3];
  unsigned block[3];
  unsigned sharedBytes;
  void **parameters;
  void **extra;
};
static_assert(sizeof(KernelNodeParameters) == 56, "the layout is the driver's");

/// Every driver function that the runtime calls: its name here, the symbol, and
/// its parameters.
#define TAI_CUDA_FUNCTIONS(DO)                                                 \
  DO(init, "cuInit", (unsigned))                                               \
  DO(driverGetVersion, "cuDriverGetVersion", (int *))                          \
  DO(getErrorName, "cuGetErrorName", (Result, const char **))                  \
  DO(getErrorString, "cuGetErrorString", (Result, const char **))              \
  DO(deviceGetCount, "cuDeviceGetCount", (int *))                              \
  DO(deviceGet, "cuDeviceGet", (DeviceNumber *, int))                          \
  DO(deviceGetName, "cuDeviceGetName", (char *, int, DeviceNumber))            \
  DO(deviceTotalMem, "cuDeviceTotalMem_v2", (size_t *, DeviceNumber))          \
  DO(deviceGetAttribute, "cuDeviceGetAttribute", (int *, int, DeviceNumber))   \
  DO(primaryCtxRetain, "cuDevicePrimaryCtxRetain", (Context *, DeviceNumber))  \
  DO(primaryCtxRelease, "cuDevicePrimaryCtxRelease_v2", (DeviceNumber))        \
  DO(primaryCtxReset, "cuDevicePrimaryCtxReset_v2", (DeviceNumber))            \
  DO(ctxGetLimit, "cuCtxGetLimit", (size_t *, int))                            \
  DO(ctxSetLimit, "cuCtxSetLimit", (int, size_t))                              \
  DO(ctxGetCurrent, "cuCtxGetCurrent", (Context *))                            \
  DO(ctxSetCurrent, "cuCtxSetCurrent", (Context))                              \
  DO(streamCreate, "cuStreamCreate", (Stream *, unsigned))                     \
  DO(streamDestroy, "cuStreamDestroy_v2", (Stream))                            \
  DO(streamSynchronize, "cuStreamSynchronize", (Stream))                       \
  DO(streamQuery, "cuStreamQuery", (Stream))                                   \
  DO(eventCreate, "cuEventCreate", (Event *, unsigned))                        \
  DO(eventDestroy, "cuEventDestroy_v2", (Event))                               \
  DO(eventRecord, "cuEventRecord", (Event, Stream))                            \
  DO(streamWaitEvent, "cuStreamWaitEvent", (Stream, Event, unsigned))          \
  DO(eventSynchronize, "cuEventSynchronize", (Event))                          \
  DO(eventQuery, "cuEventQuery", (Event))                                      \
  DO(eventElapsedTime, "cuEventElapsedTime", (float *, Event, Event))          \
  DO(memAlloc, "cuMemAlloc_v2", (Address *, size_t))                           \
  DO(memAllocManaged, "cuMemAllocManaged", (Address *, size_t, unsigned))      \
  DO(memFree, "cuMemFree_v2", (Address))                                       \
  DO(memPoolCreate, "cuMemPoolCreate", (Pool *, const PoolProperties *))       \
  DO(memPoolDestroy, "cuMemPoolDestroy", (Pool))                               \
  DO(memPoolSetAttribute, "cuMemPoolSetAttribute", (Pool, int, void *))        \
  DO(memPoolTrimTo, "cuMemPoolTrimTo", (Pool, size_t))                         \
  DO(memAllocFromPoolAsync, "cuMemAllocFromPoolAsync",                         \
     (Address *, size_t, Pool, Stream))                                        \
  DO(memFreeAsync, "cuMemFreeAsync", (Address, Stream))                        \
  DO(memGetInfo, "cuMemGetInfo_v2", (size_t *, size_t *))                      \
  DO(memAllocHost, "cuMemAllocHost_v2", (void **, size_t))                     \
  DO(memFreeHost, "cuMemFreeHost", (void *))                                   \
  DO(memcpyHtoDAsync, "cuMemcpyHtoDAsync_v2",                                  \
     (Address, const void *, size_t, Stream))                                  \
  DO(memcpyDtoHAsync, "cuMemcpyDtoHAsync_v2",                                  \
     (void *, Address, size_t, Stream))                                        \
  DO(memcpyDtoDAsync, "cuMemcpyDtoDAsync_v2",                                  \
     (Address, Address, size_t, Stream))                                       \
  DO(memsetD8Async, "cuMemsetD8Async",                                         \
     (Address, unsigned char, size_t, Stream))                                 \
  DO(memsetD16Async, "cuMemsetD16Async",                                       \
     (Address, unsigned short, size_t, Stream))                                \
  DO(memsetD32Async, "cuMemsetD32Async", (Address, unsigned, size_t, Stream))  \
  DO(pointerGetAttribute, "cuPointerGetAttribute", (void *, int, Address))     \
  DO(moduleLoadDataEx, "cuModuleLoadDataEx",                                   \
     (Module *, const void *, unsigned, int *, void **))                       \
  DO(moduleUnload, "cuModuleUnload", (Module))                                 \
  DO(linkCreate, "cuLinkCreate_v2", (unsigned, int *, void **, LinkState *))   \
  DO(linkAddData, "cuLinkAddData_v2",                                          \
     (LinkState, int, void *, size_t, const char *, unsigned, int *, void **)) \
  DO(linkComplete, "cuLinkComplete", (LinkState, void **, size_t *))           \
  DO(linkDestroy, "cuLinkDestroy", (LinkState))                                \
  DO(moduleGetFunction, "cuModuleGetFunction",                                 \
     (Function *, Module, const char *))                                       \
  DO(funcGetAttribute, "cuFuncGetAttribute", (int *, int, Function))           \
  DO(maxActiveBlocks, "cuOccupancyMaxActiveBlocksPerMultiprocessor",           \
     (int *, Function, int, size_t))                                           \
  DO(launchKernel, "cuLaunchKernel",                                           \
     (Function, unsigned, unsigned, unsigned, unsigned, unsigned, unsigned,    \
      unsigned, Stream, void **, void **))                                     \
  DO(funcSetAttribute, "cuFuncSetAttribute", (Function, int, int))             \
  DO(launchKernelEx, "cuLaunchKernelEx",                                       \
     (const LaunchConfiguration *, Function, void **, void **))                \
  DO(streamBeginCapture, "cuStreamBeginCapture_v2", (Stream, int))             \
  DO(streamEndCapture, "cuStreamEndCapture", (Stream, Graph *))                \
  DO(graphInstantiate, "cuGraphInstantiateWithFlags",                          \
     (ExecutableGraph *, Graph, unsigned long long))                           \
  DO(graphExecUpdate, "cuGraphExecUpdate_v2",                                  \
     (ExecutableGraph, Graph, GraphUpdate *))                                  \
  DO(graphLaunch, "cuGraphLaunch", (ExecutableGraph, Stream))                  \
  DO(graphCreate, "cuGraphCreate", (Graph *, unsigned))                        \
  DO(graphAddKernelNode, "cuGraphAddKernelNode",                               \
     (Node *, Graph, const Node *, size_t, const KernelNodeParameters *))      \
  DO(graphGetRootNodes, "cuGraphGetRootNodes", (Graph, Node *, size_t *))      \
  DO(graphNodeGetDependentNodes, "cuGraphNodeGetDependentNodes",               \
     (Node, Node *, size_t *))                                                 \
  DO(graphNodeGetType, "cuGraphNodeGetType", (Node, int *))                    \
  DO(graphExecKernelNodeSetParams, "cuGraphExecKernelNodeSetParams",           \
     (ExecutableGraph, Node, const KernelNodeParameters *))                    \
  DO(graphDestroy, "cuGraphDestroy", (Graph))                                  \
  DO(graphExecDestroy, "cuGraphExecDestroy", (ExecutableGraph))                \
  DO(launchCooperativeKernel, "cuLaunchCooperativeKernel",                     \
     (Function, unsigned, unsigned, unsigned, unsigned, unsigned, unsigned,    \
      unsigned, Stream, void **))

struct Driver {
#define TAI_CUDA_MEMBER(name, symbol, parameters)                              \
  Result(*name) parameters = nullptr;
  TAI_CUDA_FUNCTIONS(TAI_CUDA_MEMBER)
#undef TAI_CUDA_MEMBER

  /// Describes an error code, such as "CUDA_ERROR_NO_DEVICE: no CUDA-capable
  /// device is detected".
  std::string describe(Result result) const;

  /// Loads the CUDA driver library, once for the process, and makes sure that
  /// it is new enough.
  static Status get(const Driver *&driver);
};

} // namespace mlir::tai::runtime::cuda

#endif // TAI_LIB_RUNTIME_CUDA_DRIVER_H
