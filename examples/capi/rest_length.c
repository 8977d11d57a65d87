/*===- rest_length.c - A rest length found by gradient descent ----*- C -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Gradient descent through the simulation of a file:
//   rest_length rest_length.mlir
//
//===----------------------------------------------------------------------===*/

#include <stdio.h>
#include <stdlib.h>
#include <tai-c/Tai.h>

static TaiContext context;

static void check(TaiStatus status) {
  if (status != TAI_OK) {
    fprintf(stderr, "%s", taiContextLastError(context).diagnostics);
    exit(1);
  }
}

int main(int argc, char **argv) {
  TaiProgram program;
  TaiKernel swing;
  TaiField rest, gradient, loss;
  context = taiContextCreate();
  check(taiProgramLoadFile(context, argc > 1 ? argv[1] : NULL, &program));
  check(taiProgramGetKernel(program, "swing", &swing));
  check(taiContextFindField(context, "rest", &rest));
  check(taiContextFindField(context, "loss", &loss));
  check(taiFieldGetAdjoint(rest, &gradient));

  double length = 1, miss = 0, slope = 0;
  for (int step = 0; step < 40; ++step) {
    TaiTape tape;
    check(taiFieldWriteF64(rest, NULL, 0, length));
    check(taiTapeBegin(context, loss, true, &tape));
    check(taiKernelLaunch(swing, NULL, 0, NULL));
    check(taiTapeEnd(tape));
    check(taiTapeBackward(tape));
    taiTapeDestroy(tape);
    check(taiFieldReadF64(loss, NULL, 0, &miss));
    check(taiFieldReadF64(gradient, NULL, 0, &slope));
    length -= 0.2 * slope;
  }
  printf("rest length %.4f, loss %.1e\n", length, miss);
  taiContextDestroy(context);
  return 0;
}
