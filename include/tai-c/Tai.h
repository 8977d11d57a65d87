//===-- tai-c/Tai.h - C API of tai --------------------------------*- C -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Contexts, fields, kernels and tapes for programs in any language. IR is
// built through MLIR's own C API (mlir-c), which libtai re-exports, in the
// MlirContext of a TaiContext.
//
// Every function that can fail returns a TaiStatus; on failure
// `taiContextLastError` holds the diagnostic of the calling thread. Nothing
// aborts the process, given handles that exist and pointers to memory: a handle
// or a pointer may be null only where its function says so, also where a handle
// is destroyed. Text that is null is empty. Where memory runs out, a call fails
// with TAI_ERROR_MEMORY, or returns null if its result is a pointer; the next
// call finds the context as it was. The handles of a context are destroyed with
// the context, at the latest. Calls of several threads on one context run one
// after another, except launches and reads of single elements on the CPU, which
// run side by side; contexts are independent.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_C_TAI_H
#define TAI_C_TAI_H

#include "mlir-c/IR.h"
#include "mlir-c/Support.h"
#include "tai-c/Version.h"
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#if defined(_WIN32)
#define TAI_EXPORT
#else
#define TAI_EXPORT __attribute__((visibility("default")))
#endif

typedef struct TaiContextImpl *TaiContext;
typedef struct TaiFieldImpl *TaiField;
typedef struct TaiKernelImpl *TaiKernel;
typedef struct TaiTapeImpl *TaiTape;
typedef struct TaiProgramImpl *TaiProgram;

typedef enum TaiStatus {
  TAI_OK = 0,
  TAI_ERROR_SYNTAX = 1,   // IR or layout text that does not parse
  TAI_ERROR_TYPE = 2,     // IR that does not verify
  TAI_ERROR_AUTODIFF = 3, // no derivative, or an access rule is broken
  TAI_ERROR_RUNTIME = 4,  // an assertion, an index, a failed launch
  TAI_ERROR_MEMORY = 5,   // out of memory
  TAI_ERROR_INTERNAL = 6, // a bug in tai; the message names a reproducer
  TAI_ERROR_USAGE = 7     // an invalid call, or one not allowed in this state
} TaiStatus;

//===----------------------------------------------------------------------===//
// Context
//===----------------------------------------------------------------------===//

/// The version of tai, as in Python: "0.2.0", or "0.2.0.dev0" between releases.
TAI_EXPORT const char *taiVersion(void);

/// The version as a number: TAI_VERSION_NUMBER of the headers that libtai was
/// built with. See tai-c/Version.h.
TAI_EXPORT int taiVersionNumber(void);

/// The version of the LLVM and MLIR that libtai was built with.
TAI_EXPORT const char *taiLLVMVersion(void);

TAI_EXPORT TaiContext taiContextCreate(void);
TAI_EXPORT void taiContextDestroy(TaiContext context);

/// Describes one option of a context: its name, its initial value, a
/// description of valid values, and its purpose.
typedef struct TaiOptionRow {
  const char *name, *initial, *expects, *about;
} TaiOptionRow;

/// Returns all options of taiContextSetOption, and their number. The array of
/// options is static.
TAI_EXPORT int64_t taiListOptions(const TaiOptionRow **rows);

/// Sets an option from text. An unknown name or value is TAI_ERROR_USAGE, with
/// the valid names or values in the message. Options that affect code apply to
/// kernels created afterwards. See taiListOptions and
/// docs/reference/options.md.
TAI_EXPORT TaiStatus taiContextSetOption(TaiContext context, const char *name,
                                         const char *value);

/// Tracks the flow of tangents of the fields `inputs` until the option
/// `forward_mode` is set again; see taiContextLostTangents.
TAI_EXPORT void taiContextFollowTangents(TaiContext context,
                                         const TaiField *inputs, int64_t count);
/// The stores at which tangents were lost on the way to the fields `outputs`:
/// lines separated by newlines, each reported only once. Valid until the next
/// call.
TAI_EXPORT const char *taiContextLostTangents(TaiContext context,
                                              const TaiField *outputs,
                                              int64_t count);

/// The MLIR context in which IR for this context is built.
TAI_EXPORT MlirContext taiContextGetMlirContext(TaiContext context);

/// The last failure. `diagnostics` is the full text with one line for each
/// diagnostic and note, as "file:line:col: error: …".
typedef struct TaiError {
  TaiStatus status;
  const char *message; // the first error, without its location
  const char *file;    // "" where unknown
  int line, column;    // 1-based, 0 where unknown
  const char *diagnostics;
} TaiError;
TAI_EXPORT TaiError taiContextLastError(TaiContext context);

/// Waits for background compilations in all contexts, and disables them. Call
/// before the exit of a process that may still have contexts: code that still
/// runs would use destroyed data of its libraries.
TAI_EXPORT void taiStopBackgroundWork(void);

/// Waits until all launches of the context have ended.
TAI_EXPORT TaiStatus taiContextSynchronize(TaiContext context);

/// A callback during long calls, to handle signals or to let other threads of
/// the host run. Called about every 20 ms on the thread of a call that takes
/// that long (a launch, a sweep, a compilation, a wait); returns 0 to interrupt
/// the call, which then fails with TAI_ERROR_RUNTIME. One handler for the
/// process; null for none.
typedef int (*TaiSafepointHandler)(void);
TAI_EXPORT void taiSetSafepointHandler(TaiSafepointHandler handler);

/// Asks running launches of the context to stop; they fail with
/// TAI_ERROR_RUNTIME. Safe in a signal handler and from any thread. The request
/// stands until it is cleared.
TAI_EXPORT void taiContextInterrupt(TaiContext context);
TAI_EXPORT void taiContextClearInterrupt(TaiContext context);

/// Receives the lines of `tai.print`, one complete line with its newline in
/// each call, from any thread; null for the standard output.
typedef void (*TaiPrintHandler)(const char *line, size_t length, void *user);
TAI_EXPORT void taiContextSetPrintHandler(TaiContext context,
                                          TaiPrintHandler handler, void *user);

/// A compiler warning. Reported once in a context, also if the code comes from
/// the cache. `diagnostics` is as in TaiError. `of_gradient`: the warning is
/// about an adjoint or a forward-mode variant.
typedef struct TaiWarning {
  const char *message;
  const char *file; // "" where unknown
  int line, column; // 1-based, 0 where unknown
  const char *diagnostics;
  bool of_gradient;
} TaiWarning;
/// Receives warnings, from any thread, as kernels are compiled; null for the
/// standard error. The handler must not call the context.
typedef void (*TaiWarningHandler)(const TaiWarning *warning, void *user);
TAI_EXPORT void taiContextSetWarningHandler(TaiContext context,
                                            TaiWarningHandler handler,
                                            void *user);

//===----------------------------------------------------------------------===//
// Trees and fields
//===----------------------------------------------------------------------===//

/// Adds a tree of the given layout, e.g. "!tai.root<dense<[i: 8], {x: f32}>>",
/// and allocates it (lazily committed, zero). `name` becomes the name of its
/// `tai.tree` op.
TAI_EXPORT TaiStatus taiContextAddTree(TaiContext context, const char *name,
                                       const char *layout);

/// Frees a tree. Its fields become invalid; kernels that name them fail.
TAI_EXPORT TaiStatus taiContextDestroyTree(TaiContext context,
                                           const char *name);

/// The state of one sparse level of a tree. Levels are numbered in the order of
/// the layout, parents before children; cells row-major, level by level.
typedef struct TaiSparseLevel {
  int64_t numCells;
  int64_t cellBytes;
  int64_t numActive;
  /// The number of lists of active cells that were computed, and that were
  /// reused.
  int64_t listsMade;
  int64_t listsReused;
  /// The largest number of cells of the level that were active at any time.
  int64_t peakActive;
} TaiSparseLevel;
TAI_EXPORT TaiStatus taiContextGetSparseLevel(TaiContext context,
                                              const char *tree, int64_t level,
                                              TaiSparseLevel *result);

/// Copies the numbers of the active cells, ascending, to an array of numActive
/// numbers.
TAI_EXPORT TaiStatus taiContextGetActiveCells(TaiContext context,
                                              const char *tree, int64_t level,
                                              int64_t *cells, int64_t count);

/// Activates (1) or deactivates (0) a cell; a deactivated cell is zeroed, with
/// all its descendants.
TAI_EXPORT TaiStatus taiContextSetActive(TaiContext context, const char *tree,
                                         int64_t level, int64_t cell,
                                         int active);

/// Deactivates all cells of a level.
TAI_EXPORT TaiStatus taiContextDeactivateAll(TaiContext context,
                                             const char *tree, int64_t level);

/// Declares a field. `declaration` is the text of a `tai.field` op, e.g.
/// "tai.field @x = @scene[\"x\"] : f32, rank 1, adjoint @x_grad". The adjoint
/// that the op names need not exist yet.
TAI_EXPORT TaiStatus taiContextAddField(TaiContext context,
                                        const char *declaration,
                                        TaiField *field);

typedef enum TaiScalarType {
  TAI_I8 = 0,
  TAI_I16,
  TAI_I32,
  TAI_I64,
  TAI_F16,
  TAI_BF16,
  TAI_F32,
  TAI_F64,
  TAI_I1
} TaiScalarType;

#define TAI_MAX_RANK 12

typedef struct TaiFieldInfo {
  TaiScalarType type;
  int rank; // number of indices
  int64_t shape[TAI_MAX_RANK];
  int64_t offset[TAI_MAX_RANK]; // first index
  int element_rank;             // 0 scalar, 1 vector, 2 matrix
  int64_t element_shape[2];
} TaiFieldInfo;
TAI_EXPORT TaiStatus taiFieldGetInfo(TaiField field, TaiFieldInfo *info);
/// Destroys the handle of a field, not the field. Handles that are not released
/// are destroyed with the context.
TAI_EXPORT void taiFieldRelease(TaiField field);

/// Returns true if there is a kernel of that name, including a destroyed kernel
/// that a tape may still launch. Can be called from any thread; does not wait.
TAI_EXPORT bool taiContextHasKernel(TaiContext context, const char *name);

/// The number of objects in a context, to detect leaks.
typedef struct TaiContextObjects {
  int64_t trees;
  int64_t fields;
  int64_t declarations; // trees and fields as IR
  int64_t field_handles;
  int64_t kernel_handles;
  int64_t tape_handles;
  int64_t kernels;      // kernels that may be launched, with adjoints
  int64_t kernel_codes; // modules that kernels are compiled from
  int64_t linked;       // pieces of compiled code
  int64_t failures;     // of compilations, kept for later queries
} TaiContextObjects;
/// Zeroes the tangent fields that the calling thread has written.
TAI_EXPORT TaiStatus taiContextClearTangents(TaiContext context);
TAI_EXPORT TaiStatus taiContextCountObjects(TaiContext context,
                                            TaiContextObjects *objects);

/// Read and write one element or one component, as double or int64 whatever the
/// type of the field. `indices` has rank numbers; `component` is row-major in
/// the element.
TAI_EXPORT TaiStatus taiFieldReadF64(TaiField field, const int64_t *indices,
                                     int64_t component, double *value);
TAI_EXPORT TaiStatus taiFieldWriteF64(TaiField field, const int64_t *indices,
                                      int64_t component, double value);
TAI_EXPORT TaiStatus taiFieldReadI64(TaiField field, const int64_t *indices,
                                     int64_t component, int64_t *value);
TAI_EXPORT TaiStatus taiFieldWriteI64(TaiField field, const int64_t *indices,
                                      int64_t component, int64_t value);

/// Read and write the elements at `count` index tuples. `indices` has shape
/// (count, rank); `values` is an array of the field's own scalar type, of shape
/// (count, element_shape...). Writing makes the cells active.
TAI_EXPORT TaiStatus taiFieldReadElements(TaiField field,
                                          const int64_t *indices, int64_t count,
                                          void *values);
TAI_EXPORT TaiStatus taiFieldWriteElements(TaiField field,
                                           const int64_t *indices,
                                           int64_t count, const void *values);

/// The address of the element at these indices: in GPU memory, if the context
/// has a GPU.
TAI_EXPORT TaiStatus taiFieldGetAddress(TaiField field, const int64_t *indices,
                                        void **address);

/// Memory of a field that another library uses. The memory is kept until the
/// buffer is released, even after the field and the context are destroyed.
typedef struct TaiExportedBufferImpl *TaiExportedBuffer;
typedef struct TaiFieldMemory {
  void *address; // of the first element
  int32_t on_device;
  /// Strides in bytes, for each dimension of the field and of its element;
  /// owned by the buffer.
  const int64_t *strides;
} TaiFieldMemory;
/// Exports the memory of a field to another library. Fails for sparse fields,
/// and for layouts without a uniform stride.
TAI_EXPORT TaiStatus taiFieldExport(TaiField field, TaiFieldMemory *memory,
                                    TaiExportedBuffer *buffer);
TAI_EXPORT void taiExportedBufferRelease(TaiExportedBuffer buffer);
/// Notes that another library has written to an exported field. Must be called
/// after such a write. Fails while a tape records.
TAI_EXPORT TaiStatus taiFieldNoteWrite(TaiField field);
/// WaitForStream makes later work of the context wait for the work now in a
/// CUDA stream; LetStreamWait makes later work of the stream wait for the work
/// of the context. 0 is the default stream. No effect without a GPU.
TAI_EXPORT TaiStatus taiContextWaitForStream(TaiContext context,
                                             uint64_t stream);
TAI_EXPORT TaiStatus taiContextLetStreamWait(TaiContext context,
                                             uint64_t stream);
/// Allocates GPU memory for copies of arrays. Must be freed before the context
/// is destroyed.
TAI_EXPORT TaiStatus taiContextAllocateOnDevice(TaiContext context,
                                                int64_t bytes, void **address);
TAI_EXPORT void taiContextFreeOnDevice(TaiContext context, void *address);
/// Copies on the GPU, in order with launches. A copy in a sweep or replay of a
/// tape becomes part of the sweep or replay.
TAI_EXPORT TaiStatus taiContextCopyOnDevice(TaiContext context, void *to,
                                            const void *from, int64_t bytes);
/// Copies `rows` pieces of `bytes` bytes each from the GPU's memory to the
/// host, in order with launches. Each piece begins `step` bytes after the
/// beginning of the piece before.
TAI_EXPORT TaiStatus taiContextReadOnDevice(TaiContext context,
                                            const void *from, int64_t step,
                                            int64_t bytes, int64_t rows,
                                            void *to);
/// Returns 1 if kernels on the GPU, or on the emulated GPU, can access the
/// address, else 0.
TAI_EXPORT int taiContextIsOnDevice(TaiContext context, const void *address);
/// Returns 1 if kernels run on a real GPU, else 0.
TAI_EXPORT int taiContextIsOnGpu(TaiContext context);

/// Copy all elements to or from a row-major array of the field's own scalar
/// type, of shape (shape..., element_shape...). For a sparse field, copying
/// from the host activates the cells of non-zero elements.
TAI_EXPORT TaiStatus taiFieldCopyToHost(TaiField field, void *array);
TAI_EXPORT TaiStatus taiFieldCopyFromHost(TaiField field, const void *array);
TAI_EXPORT TaiStatus taiFieldFillF64(TaiField field, double value);
TAI_EXPORT TaiStatus taiFieldFillI64(TaiField field, int64_t value);

/// Sets all adjoint fields that may be non-zero to zero.
TAI_EXPORT TaiStatus taiContextClearGradients(TaiContext context);

//===----------------------------------------------------------------------===//
// Kernels
//===----------------------------------------------------------------------===//

/// Creates a kernel from a module with one `tai.kernel` of the given name (and
/// any `func.func` helpers). The context adds the declarations of its trees and
/// fields that the module uses: the module need not hold `tai.tree` and
/// `tai.field` ops. The module is verified here and compiled on the first
/// launch. The module is owned by the kernel afterwards, also on failure.
TAI_EXPORT TaiStatus taiKernelCreate(TaiContext context, MlirModule module,
                                     const char *name, TaiKernel *kernel);
/// As taiKernelCreate, for IR as text; `file` names it in diagnostics.
TAI_EXPORT TaiStatus taiKernelParse(TaiContext context, const char *text,
                                    const char *file, const char *name,
                                    TaiKernel *kernel);
/// As taiKernelCreate, for IR from a file or the network: text, or the output
/// of taiModuleWrite. Bytecode that is damaged, or that has no checksum (like
/// bytecode of MLIR's own writer), is a syntax error here, while
/// mlirModuleCreateParse may end the process on it.
TAI_EXPORT TaiStatus taiKernelLoad(TaiContext context, const char *bytes,
                                   size_t size, const char *file,
                                   const char *name, TaiKernel *kernel);
/// Writes the module as bytecode with a checksum, in pieces, to `callback`.
TAI_EXPORT TaiStatus taiModuleWrite(TaiContext context, MlirModule module,
                                    MlirStringCallback callback,
                                    void *userData);
TAI_EXPORT void taiKernelDestroy(TaiKernel kernel);

/// The name of tree number `number` that the kernel may use, including the
/// trees of gradients; null after the last tree.
TAI_EXPORT const char *taiKernelGetTree(TaiKernel kernel, int64_t number);

/// Launches a kernel with arguments in slots (see TaiFrame in tai/ABI/Abi.h).
/// `results` may be null for a kernel without result. The launch is recorded by
/// the active tape.
///
/// A kernel with the attribute `gradients` is differentiated with respect to
/// arguments and results. A launch under a tape, and its adjoint, have
/// additional slots for the adjoints of these arguments and results after the
/// slots of the arguments, as for arrays (see `--tai-make-adjoint`). The memory
/// of the adjoints must live as long as the tape.
TAI_EXPORT TaiStatus taiKernelLaunch(TaiKernel kernel, const uint64_t *args,
                                     int64_t slots, uint64_t *results);
/// Launches the adjoint of the kernel.
TAI_EXPORT TaiStatus taiKernelLaunchGrad(TaiKernel kernel, const uint64_t *args,
                                         int64_t slots);

/// True if the adjoint of the kernel reads elements of the array argument whose
/// pointer is in this slot: the elements must then not change after the launch.
TAI_EXPORT bool taiKernelReadsInReverse(TaiKernel kernel, int64_t slot);

/// True if the kernel stores, to the array argument whose pointer is in this
/// slot and which has no gradient, values that may depend on differentiable
/// values.
TAI_EXPORT bool taiKernelEndsGradients(TaiKernel kernel, int64_t slot);

/// Compiles the kernels (and their adjoints) now instead of at their first
/// launch, several in parallel.
TAI_EXPORT TaiStatus taiKernelsCompile(TaiContext context, TaiKernel *kernels,
                                       int64_t count, bool adjoints);

/// The IR of the kernel at a stage: "tai" as given, "autodiff" with the
/// adjoint, "scf", "llvm" dialect, "llvmir", "asm"; with a device also "nvvm"
/// and "ptx". From "scf" on, the prefix "adjoint." selects the adjoint, and
/// "tangent." before that the forward-mode variant. "explain" is a text about
/// the gradient. Owned by the kernel, valid until the next call.
TAI_EXPORT TaiStatus taiKernelGetIR(TaiKernel kernel, const char *stage,
                                    const char **text);

//===----------------------------------------------------------------------===//
// Programs: whole files
//===----------------------------------------------------------------------===//
//
// Null arguments of these functions are refused with TAI_ERROR_USAGE, and names
// may begin with '@'.

/// Loads a module with trees, fields, kernels, and functions that run on the
/// host, as `tai-run` does. `bytes` is text or the output of taiModuleWrite,
/// and `file` names it in diagnostics. The trees and fields of the module
/// become trees and fields of the context. On failure, the context keeps
/// nothing of the module.
TAI_EXPORT TaiStatus taiProgramLoad(TaiContext context, const char *bytes,
                                    size_t size, const char *file,
                                    TaiProgram *program);
/// As taiProgramLoad, for the file at a path.
TAI_EXPORT TaiStatus taiProgramLoadFile(TaiContext context, const char *path,
                                        TaiProgram *program);
/// As taiProgramLoad, for a module, which is owned by the program afterwards,
/// also on failure.
TAI_EXPORT TaiStatus taiProgramCreate(TaiContext context, MlirModule module,
                                      TaiProgram *program);
/// Destroys the program with its kernels and functions, and their handles. Its
/// trees and fields are kept; see taiContextDestroyTree.
TAI_EXPORT void taiProgramDestroy(TaiProgram program);

typedef enum TaiSymbolKind {
  TAI_SYMBOL_TREE = 0,
  TAI_SYMBOL_FIELD = 1,
  TAI_SYMBOL_KERNEL = 2,
  TAI_SYMBOL_FUNCTION = 3, // that runs on the host
  TAI_SYMBOL_LOSS = 4,     // of a saved program: the field
  TAI_SYMBOL_WRT = 5       // of a saved program: fields with a gradient
} TaiSymbolKind;
/// Returns the name of symbol number `number` of a kind in the program, in the
/// order of the file; null after the last one. Owned by the program.
TAI_EXPORT const char *taiProgramGetSymbol(TaiProgram program,
                                           TaiSymbolKind kind, int64_t number);
/// A handle of a kernel of the program. The handle is the same each time, and
/// destroyed with the program; taiKernelDestroy leaves the kernel in the
/// program.
TAI_EXPORT TaiStatus taiProgramGetKernel(TaiProgram program, const char *name,
                                         TaiKernel *kernel);
/// Runs a `func.func` without arguments and results, such as "main". The tapes
/// of the function are its own; its launches are recorded by the active tape.
/// Under a tape, the function must not access fields other than by launches.
TAI_EXPORT TaiStatus taiProgramRun(TaiProgram program, const char *function);

/// A handle of a field of the context, by name.
TAI_EXPORT TaiStatus taiContextFindField(TaiContext context, const char *name,
                                         TaiField *field);
/// The gradient of a field; TAI_ERROR_USAGE for a field without one.
TAI_EXPORT TaiStatus taiFieldGetAdjoint(TaiField field, TaiField *adjoint);

/// Runs `run(user)` under a tape, and compares the gradient of `loss` by each
/// of `count` fields with central differences along four random directions. A
/// relative error above `tolerance` is TAI_ERROR_RUNTIME, with both numbers in
/// the message. `run` is called about 150 times, each from the same contents of
/// the fields; it must not open a tape. Not for contexts with sparse trees.
typedef TaiStatus (*TaiRun)(void *user);
TAI_EXPORT TaiStatus taiCheckGradient(TaiContext context, TaiField loss,
                                      const TaiField *fields, int64_t count,
                                      double tolerance, TaiRun run, void *user);

/// Loads a library of dialects, of passes or of both, as `mlir-opt` does,
/// before the context has kernels. The library must use the same shared
/// libraries of LLVM and MLIR as libtai; the libtai of the portable bundle
/// refuses plugins.
TAI_EXPORT TaiStatus taiContextLoadPlugin(TaiContext context, const char *path);
/// Reads a module without verifying it, for taiModuleRunPasses and
/// taiProgramCreate; arguments as in taiProgramLoad. Owned by the caller.
TAI_EXPORT TaiStatus taiModuleRead(TaiContext context, const char *bytes,
                                   size_t size, const char *file,
                                   MlirModule *module);
/// Runs passes on a module: passes of tai, passes of plugins, and
/// `canonicalize`, `cse`, `inline` and the other general passes of MLIR.
/// `pipeline` is the text of `--pass-pipeline`.
TAI_EXPORT TaiStatus taiModuleRunPasses(TaiContext context, MlirModule module,
                                        const char *pipeline);

/// A kernel, or a function of the host, that `tai-to-llvm` has compiled ahead
/// of time.
struct TaiFrame;
typedef int32_t (*TaiFunction)(struct TaiFrame *frame);
/// Runs a TaiFunction with a frame and the runtime of the context. `trees` has
/// the names of `num_trees` trees, in the order of the `tai.tree` ops of the
/// function's module; the trees must have the layouts for which the function
/// was compiled. Slots are as for taiKernelLaunch; the code itself knows their
/// number. Kernels that the function launches are found in the context by name.
/// Fails while a tape records, because the tape cannot know the accesses of
/// such code.
TAI_EXPORT TaiStatus taiContextRunFunction(
    TaiContext context, TaiFunction function, const char *const *trees,
    int64_t num_trees, const uint64_t *args, uint64_t *results);

//===----------------------------------------------------------------------===//
// Tape
//===----------------------------------------------------------------------===//

/// Starts recording the launches of the context. `loss` is a 0-D field with an
/// adjoint, or null where the caller seeds gradients; the loss is set to zero.
/// With `clear_gradients`, adjoint fields are cleared first. Tapes do not nest.
TAI_EXPORT TaiStatus taiTapeBegin(TaiContext context, TaiField loss,
                                  bool clear_gradients, TaiTape *tape);
/// Adds a field that the sweep starts from, while the tape has no records. A
/// field of one number is set to zero, and its seed is 1.
TAI_EXPORT TaiStatus taiTapeAddLoss(TaiTape tape, TaiField loss);
/// Asks for the gradients of these fields only, while the tape has no records:
/// launches that lead to none of them are skipped. After a sweep the gradients
/// of the other fields that the sweep uses are zero, except those of losses.
TAI_EXPORT TaiStatus taiTapeWant(TaiTape tape, const TaiField *fields,
                                 int64_t count);
/// Makes the tape incremental, while it has no records: a launch is recorded,
/// and not run, if an earlier incremental tape has run it, and the fields that
/// it reads and writes have not been written since.
TAI_EXPORT TaiStatus taiTapeSkipUnchanged(TaiTape tape);
/// Sets the gradient of a loss at the start of a sweep: a row-major array of
/// the type of the gradient.
TAI_EXPORT TaiStatus taiTapeSetSeed(TaiTape tape, TaiField loss,
                                    const void *array);
/// How the tape trades recomputation for saved values; set before anything is
/// recorded. `snapshots`: the maximum number of snapshots, 0 for about the
/// square root of the number of records. `budget`: maximum of bytes in
/// snapshots and saved values, 0 for no limit.
typedef enum TaiCheckpoint {
  TAI_CHECKPOINT_NONE = 0, // saves values only
  TAI_CHECKPOINT_PERIODIC, // snapshots at even distances, saves in between
  TAI_CHECKPOINT_BINOMIAL, // snapshots only
  TAI_CHECKPOINT_MIXED     // periodic where the values in between fit
} TaiCheckpoint;
TAI_EXPORT TaiStatus taiTapeSetCheckpoint(TaiTape tape, TaiCheckpoint kind,
                                          int64_t snapshots, int64_t budget);
/// Stops the recording of a tape, which can still be run backward and replayed.
TAI_EXPORT TaiStatus taiTapeEnd(TaiTape tape);
/// As taiTapeEnd, if taiTapeBackward follows: a device may then run the
/// recording together with its reverse sweep.
TAI_EXPORT TaiStatus taiTapeEndToSweep(TaiTape tape);
/// Zeroes the gradients that the sweep adds to, and all other gradients that
/// the calling thread has written.
TAI_EXPORT TaiStatus taiTapeClearGradients(TaiTape tape);
/// Runs the reverse sweep: seeds the adjoint of the loss with 1 and launches
/// the adjoints of the recorded kernels in reverse.
TAI_EXPORT TaiStatus taiTapeBackward(TaiTape tape);
/// Runs a tape again. `forward`: runs the recorded launches on the current
/// contents of the fields; `backward`: clears gradients, seeds, and reverses.
TAI_EXPORT TaiStatus taiTapeReplay(TaiTape tape, bool forward, bool backward);
/// Records a host function: `forward` is called in its place by a replay,
/// `backward` at its place in the reverse sweep (custom gradients). Launches
/// made between taiTapeSuspend and taiTapeResume are not recorded.
typedef TaiStatus (*TaiTapeCallback)(void *user);
TAI_EXPORT TaiStatus taiTapeRecordCallback(TaiTape tape,
                                           TaiTapeCallback forward,
                                           TaiTapeCallback backward,
                                           void *user);
/// The memory of an array of the caller: its first byte, one past its last
/// byte, a divisor of the distances between elements, and their size.
typedef struct TaiArrayRange {
  uint64_t begin, end, step, element_bytes;
} TaiArrayRange;
/// For warnings about lost gradients. taiTapeNoteArrayCopy: the next launch
/// gets, at this address, a copy of an array, which is copied back.
/// taiTapeNoteArrayWrite: the caller has changed an array since the last
/// launch.
TAI_EXPORT void taiTapeNoteArrayCopy(TaiTape tape, const void *address,
                                     TaiArrayRange array);
TAI_EXPORT void taiTapeNoteArrayWrite(TaiTape tape, TaiArrayRange array);
/// Saves the launches of a tape as a program: a file for taiProgramLoadFile and
/// `tai-run`, with the present contents of the fields that the launches use
/// (before the call, set these fields to their contents at the start). The
/// function "run" of the program launches the kernels, and "gradient" does so
/// under a tape of `loss`; TAI_SYMBOL_WRT lists `fields`. Fails for a tape that
/// has more than launches, for arrays of the caller and for sparse fields.
TAI_EXPORT TaiStatus taiTapeSave(TaiTape tape, const char *path, TaiField loss,
                                 const TaiField *fields, int64_t count);
TAI_EXPORT TaiStatus taiTapeSuspend(TaiTape tape);
TAI_EXPORT TaiStatus taiTapeResume(TaiTape tape);
/// Describes the last sweep, with one line for each record: replayed or
/// skipped, and why. Owned by the tape.
TAI_EXPORT const char *taiTapeExplain(TaiTape tape);
TAI_EXPORT int64_t taiTapeNumRecords(TaiTape tape);
TAI_EXPORT int64_t taiTapeNumSkipped(TaiTape tape);
/// Memory statistics of a tape: bytes of saved values, now and at most. With a
/// checkpoint policy: the maximum number of snapshots, the bytes of the
/// largest, the number of re-executed records since the sequence last ran
/// forward, and the optimum by the binomial formula.
typedef struct TaiTapeStats {
  int64_t saved_bytes, peak_bytes;
  int64_t snapshots, snapshot_bytes, recomputed, optimum;
} TaiTapeStats;
TAI_EXPORT TaiStatus taiTapeGetStats(TaiTape tape, TaiTapeStats *stats);
/// Warning number `number` about the last sweep; null after the last one. Valid
/// until the next sweep.
TAI_EXPORT const char *taiTapeWarning(TaiTape tape, int64_t number);
/// Runs one record of a tape again, on the current contents of the fields and
/// with the same random numbers. Recorded by another tape, if one is recording.
TAI_EXPORT TaiStatus taiTapeRunRecord(TaiTape tape, int64_t record);
/// The name of the kernel of a record, or null for a host function.
TAI_EXPORT const char *taiTapeRecordKernel(TaiTape tape, int64_t record);
/// An access of a record to a field. `index` is the fixed index of the launch
/// along `dimension`, counted from the first index of the field; `dimension` is
/// -1 if none is fixed. Kinds: 0 read, 1 write, 2 accumulate.
typedef struct TaiTapeAccess {
  const char *field;
  int32_t kind, dimension;
  int64_t index;
} TaiTapeAccess;
/// Lists the accesses of a record. The returned array is owned by the tape, and
/// valid until the next call.
TAI_EXPORT TaiStatus taiTapeRecordAccesses(TaiTape tape, int64_t record,
                                           const TaiTapeAccess **rows,
                                           int64_t *count);
/// Statistics of an adjoint field after the adjoint of a record: number of NaNs
/// and infinities, greatest magnitude and norm of the finite numbers.
typedef struct TaiTapeHealthRow {
  int64_t record;
  const char *field;
  int64_t nans, infs;
  double max_abs, norm;
} TaiTapeHealthRow;
/// Makes later reverse sweeps of the tape examine the result of each record, or
/// not.
TAI_EXPORT TaiStatus taiTapeWatchHealth(TaiTape tape, bool on);
/// Lists the statistics of adjoint fields that the last sweep gathered, in the
/// order of the sweep. The rows are owned by the tape and valid until the next
/// call.
TAI_EXPORT TaiStatus taiTapeHealth(TaiTape tape, const TaiTapeHealthRow **rows,
                                   int64_t *count);
/// Checks the global data access rules in the launches that follow, element by
/// element, and keeps the first `limit` violations. With `races_only`, only
/// races between iterations of one loop (kinds 3 and 4).
TAI_EXPORT TaiStatus taiTapeCheckAccesses(TaiTape tape, int64_t limit,
                                          bool races_only);
/// One access of a violation: the kernel, the launch (counted among the checked
/// launches, -1 if not known), the kind (0 read, 1 write, 2 accumulate) and the
/// source location.
typedef struct TaiAccessPlace {
  const char *kernel;
  int64_t launch;
  int32_t kind;
  const char *file;
  int64_t line, column;
} TaiAccessPlace;
/// kind: 0 overwritten after it was read, 1 accumulated after it was read,
/// 2 written twice, 3 written by two iterations, 4 read while another iteration
/// writes. `component` is row-major, -1 for scalars.
typedef struct TaiViolation {
  int32_t kind;
  const char *field;
  const int64_t *indices;
  int32_t rank;
  int64_t component;
  TaiAccessPlace access, earlier;
} TaiViolation;
/// Lists the violations of the data access rules; `total` includes violations
/// that were not kept. Valid until the next call on the tape.
TAI_EXPORT TaiStatus taiTapeViolations(TaiTape tape, const TaiViolation **rows,
                                       int64_t *count, int64_t *total);

TAI_EXPORT void taiTapeDestroy(TaiTape tape);

//===----------------------------------------------------------------------===//
// Profiler
//===----------------------------------------------------------------------===//

/// The subject of a row: a kernel on the CPU, a loop or another part of a
/// kernel on a device, or copies and fills of a device.
typedef enum TaiProfileKind {
  TAI_PROFILE_HOST = 0,
  TAI_PROFILE_DEVICE = 1,
  TAI_PROFILE_MEMORY = 2
} TaiProfileKind;

typedef struct TaiProfileRow {
  const char *kernel;
  int64_t launches;
  double total_ms, min_ms, max_ms;
  const char *place; // "file:line:column", or ""
  TaiProfileKind kind;
  int64_t bytes; // that a launch accesses, each element once; -1 for not known
  // These numbers are for device code only; -1 if not known.
  int32_t registers;        // of a thread
  int32_t local_bytes;      // of a thread: spilled registers and local arrays
  int32_t shared_bytes;     // of a block
  double occupancy;         // 0 to 1
  uint32_t blocks, threads; // of the last launch; threads of a block
} TaiProfileRow;
/// Lists the profiled times since the last clear. The returned array is owned
/// by the context, and valid until the next call. Waits for the device.
TAI_EXPORT TaiStatus taiProfilerRows(TaiContext context,
                                     const TaiProfileRow **rows,
                                     int64_t *count);

/// One launch or copy. On a device it has two times: when the host queued it,
/// and when the device did it.
typedef struct TaiTraceEvent {
  const char *name;
  const char *place;
  TaiProfileKind kind;
  int32_t on_device;
  int32_t thread; // of the host, in the order of first use
  double start_us, duration_us, queued_us; // since the context was made
  uint32_t blocks, threads;
} TaiTraceEvent;
/// Lists the profiled events since the last clear, in the order of their start;
/// owned by the context, valid until the next call. `lost` receives the number
/// of dropped events. Waits for the device.
TAI_EXPORT TaiStatus taiProfilerTrace(TaiContext context,
                                      const TaiTraceEvent **events,
                                      int64_t *count, int64_t *lost);
TAI_EXPORT TaiStatus taiProfilerClear(TaiContext context);

/// An operation of a kernel where digits were lost, with the option "shadow".
/// Errors are relative to the result with more digits, at most 1.
typedef struct TaiShadowRow {
  const char *operation, *kernel;
  const char *place;     // "file:line:column", or ""
  int32_t precision;     // bits of a number of its type
  int64_t lost;          // results with less than half of the bits correct
  int64_t cancellations; // of them, differences of much larger numbers
  int64_t flips; // comparisons and conversions with another result than with
                 // more digits
  int64_t non_finite; // infinite or NaN, and finite with more digits
  // The worst result: its error, the error of its operands, and the bits lost.
  double error_made, error_in, bits_lost;
} TaiShadowRow;
/// Findings since the last clear, greatest loss first; owned by the context,
/// valid until the next call. Fails if the option is off.
TAI_EXPORT TaiStatus taiShadowRows(TaiContext context,
                                   const TaiShadowRow **rows, int64_t *count);
TAI_EXPORT TaiStatus taiShadowClear(TaiContext context);
/// Sets each of `count` errors to the distance by which the shadow of a float
/// lies above it. The floats have 32 or 64 bits and lie one after another in
/// memory that kernels write. The distance is 0 if a kernel did not store the
/// float last.
TAI_EXPORT TaiStatus taiShadowErrors(TaiContext context, const void *floats,
                                     int32_t bits, int64_t count,
                                     double *errors);

/// One counter of one skip: how often work was left out because the scene does
/// not need it, or was done. Rows of one skip are consecutive.
typedef struct TaiSkipRow {
  const char *skip;    // a name for the option "skip"
  const char *counter; // "bytes…" for an amount of memory
  int64_t value;
  int on; // whether the skip is on
} TaiSkipRow;
/// All counters since the last clear; owned by the context, valid until the
/// next call. Amounts of memory in use are current amounts.
TAI_EXPORT TaiStatus taiProfilerSkips(TaiContext context,
                                      const TaiSkipRow **rows, int64_t *count);
TAI_EXPORT TaiStatus taiProfilerClearSkips(TaiContext context);

#ifdef __cplusplus
}
#endif

#include "tai-c/Sizes.h"

#endif // TAI_C_TAI_H
