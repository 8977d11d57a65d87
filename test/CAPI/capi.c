/*===- capi.c - The C API from C ---------------------------------*- C -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// This program stands for one in another language: it declares fields, gives
// kernels as IR, launches, differentiates through a tape, and meets errors.
//
//===----------------------------------------------------------------------===*/

#include "tai-c/Tai.h"
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static TaiContext context;

/* Ends the program where a call fails that must not. */
static void check(TaiStatus status) {
  if (status == TAI_OK)
    return;
  printf("unexpected failure %d: %s\n", (int)status,
         taiContextLastError(context).diagnostics);
  exit(1);
}

static const char *sumText = "tai.kernel @sum() {\n"
                             "  tai.parallel_for (%i) in @x {\n"
                             "    %v = tai.load @x[%i] : f64\n"
                             "    %q = arith.mulf %v, %v : f64\n"
                             "    %old = tai.atomic add %q, @y[] : f64\n"
                             "  }\n"
                             "  tai.return\n"
                             "}\n";

static const char *printText = "tai.kernel @show(%i: i32) {\n"
                               "  %n = arith.index_cast %i : i32 to index\n"
                               "  %v = tai.load @x[%n] : f64\n"
                               "  tai.print \"x[{}] = {}\"(%i, %v) : i32, f64\n"
                               "  tai.return\n"
                               "}\n";

static const char *wrongText = "tai.kernel @wrong() {\n"
                               "  %v = tai.load @nothing[] : f64\n"
                               "  tai.store %v, @y[] : f64\n"
                               "  tai.return\n"
                               "}\n";

static TaiStatus create(const char *text, const char *name, TaiKernel *kernel) {
  return taiKernelParse(context, text, "kernel", name, kernel);
}

static void onPrint(const char *line, size_t length, void *user) {
  (void)user;
  printf("printed: %.*s", (int)length, line);
}

struct Bytes {
  size_t size;
  char data[1 << 16];
};

static void append(MlirStringRef piece, void *user) {
  struct Bytes *bytes = user;
  memcpy(bytes->data + bytes->size, piece.data, piece.length);
  bytes->size += piece.length;
}

static int backwardCalls = 0;
static TaiStatus onBackward(void *user) {
  (void)user;
  ++backwardCalls;
  return TAI_OK;
}

int main(void) {
  printf("version %s, LLVM %s\n", taiVersion(), taiLLVMVersion());
  context = taiContextCreate();
  check(taiContextAddTree(
      context, "t",
      "!tai.root<dense<[i: 4], {x: f64, gx: f64}>, {y: f64, gy: f64}>"));
  TaiField x, y, gx, gy;
  check(taiContextAddField(
      context, "tai.field @x = @t[\"x\"] : f64, rank 1, adjoint @gx", &x));
  check(taiContextAddField(context, "tai.field @gx = @t[\"gx\"] : f64, rank 1",
                           &gx));
  check(taiContextAddField(
      context, "tai.field @y = @t[\"y\"] : f64, rank 0, adjoint @gy", &y));
  check(taiContextAddField(context, "tai.field @gy = @t[\"gy\"] : f64, rank 0",
                           &gy));
  TaiFieldInfo info;
  check(taiFieldGetInfo(x, &info));
  printf("x: rank %d, shape %d, type %d\n", info.rank, (int)info.shape[0],
         (int)info.type);

  double values[4] = {0, 1, 2, 3}, gradient[4], loss;
  values[3] = 5; /* overwritten below, one element at a time */
  check(taiFieldCopyFromHost(x, values));
  int64_t last = 3;
  check(taiFieldWriteF64(x, &last, 0, 3));

  TaiKernel sum;
  check(create(sumText, "sum", &sum));
  check(taiKernelsCompile(context, &sum, 1, true));
  TaiTape tape;
  /* 0 + 1 + 4 + 9: the tape clears the 16 that was there */
  check(taiFieldFillF64(y, 16));
  check(taiTapeBegin(context, y, true, &tape));
  check(taiKernelLaunch(sum, NULL, 0, NULL));
  check(taiTapeEnd(tape));
  check(taiTapeBackward(tape));
  check(taiFieldReadF64(y, NULL, 0, &loss));
  printf("y = %g\n", loss);
  check(taiFieldCopyToHost(gx, gradient));
  printf("dy/dx = %g %g %g %g\n", gradient[0], gradient[1], gradient[2],
         gradient[3]);

  for (int i = 0; i < 4; ++i)
    values[i] = 2 * i;
  check(taiFieldCopyFromHost(x, values));
  check(taiFieldFillF64(y, 64));
  check(taiTapeReplay(tape, true, true));
  check(taiFieldReadF64(y, NULL, 0, &loss));
  check(taiFieldCopyToHost(gx, gradient));
  printf("replayed: y = %g, dy/dx = %g %g %g %g\n", loss, gradient[0],
         gradient[1], gradient[2], gradient[3]);
  printf("records %d, skipped %d\n", (int)taiTapeNumRecords(tape),
         (int)taiTapeNumSkipped(tape));
  taiTapeDestroy(tape);

  taiContextSetPrintHandler(context, onPrint, NULL);
  TaiKernel show;
  check(create(printText, "show", &show));
  check(taiFieldWriteF64(x, &last, 0, 3));
  uint64_t args[1] = {3};
  check(taiKernelLaunch(show, args, 1, NULL));

  const char *stages[] = {"tai", "autodiff", "scf", "llvm", "llvmir", "asm"};
  for (int i = 0; i < 6; ++i) {
    const char *text;
    check(taiKernelGetIR(sum, stages[i], &text));
    if (!strstr(text, "sum")) {
      printf("stage %s does not show the kernel\n", stages[i]);
      return 1;
    }
  }
  printf("stages present\n");

  /* The kernel, by way of a file. */
  const char *text;
  check(taiKernelGetIR(sum, "tai", &text));
  MlirModule module = mlirModuleCreateParse(taiContextGetMlirContext(context),
                                            mlirStringRefCreateFromCString(text));
  struct Bytes file = {0, {0}};
  check(taiModuleWrite(context, module, append, &file));
  mlirModuleDestroy(module);
  TaiKernel loaded;
  check(taiKernelLoad(context, file.data, file.size, "file", "sum", &loaded));
  check(taiFieldFillF64(y, 0));
  check(taiKernelLaunch(loaded, NULL, 0, NULL));
  check(taiFieldReadF64(y, NULL, 0, &loss));
  printf("loaded: y = %g\n", loss);
  size_t header = 24;
  if (taiKernelLoad(context, file.data + header, file.size - header, "raw",
                    "sum", &loaded) == TAI_ERROR_SYNTAX)
    printf("raw: %s\n", taiContextLastError(context).diagnostics);
  file.data[file.size / 2] ^= 1;
  if (taiKernelLoad(context, file.data, file.size, "damaged", "sum", &loaded) ==
      TAI_ERROR_SYNTAX)
    printf("damaged: %s\n", taiContextLastError(context).diagnostics);
  if (taiKernelLoad(context, NULL, 0, "none", "sum", &loaded) ==
      TAI_ERROR_USAGE)
    printf("none: %s\n", taiContextLastError(context).message);
  if (taiKernelLoad(context, "", 0, "empty", "sum", &loaded) != TAI_OK)
    printf("empty: %s\n", taiContextLastError(context).message);
  if (taiKernelLoad(context, NULL, 0, NULL, NULL, &loaded) == TAI_ERROR_USAGE)
    printf("no names: refused\n");
  if (taiKernelParse(context, NULL, NULL, NULL, &loaded) != TAI_OK)
    printf("no text: %s\n", taiContextLastError(context).message);

  if (taiContextSetOption(context, "colour", "red") == TAI_ERROR_USAGE &&
      strstr(taiContextLastError(context).message, "threads"))
    printf("unknown option refused\n");
  TaiKernel wrong;
  if (create(wrongText, "wrong", &wrong) == TAI_ERROR_TYPE) {
    TaiError error = taiContextLastError(context);
    if (strstr(error.message, "nothing") && error.line == 2 &&
        !strcmp(error.file, "kernel"))
      printf("no such field: refused\n");
    else
      printf("%s:%d: %s\n", error.file, error.line, error.message);
  }
  if (taiKernelLaunch(show, NULL, 0, NULL) == TAI_ERROR_USAGE)
    printf("wrong slots refused\n");

  check(taiTapeBegin(context, y, true, &tape));
  check(taiTapeRecordCallback(tape, NULL, onBackward, NULL));
  check(taiTapeSuspend(tape));
  check(taiKernelLaunch(sum, NULL, 0, NULL));
  check(taiTapeResume(tape));
  check(taiTapeBackward(tape));
  printf("custom gradient ran %d time\n", backwardCalls);
  taiTapeDestroy(tape);

  taiKernelDestroy(show);
  taiContextDestroy(context);
  printf("done\n");
  return 0;
}
