/*===- rest_length.c - A rest length found by gradient descent ----*- C -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A mass hangs on a spring: 100 steps of 0.02 s. Gradient descent through the
// simulation finds the rest length that puts it at a height of -2 m at the end.
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

/* A field of one number, and its gradient. */
static TaiField addField(const char *name, TaiField *gradient) {
  char tree[20], text[200];
  TaiField field;
  snprintf(tree, sizeof(tree), "%s_tree", name);
  check(taiContextAddTree(context, tree, "!tai.root<{x: f64, grad: f64}>"));
  snprintf(text, sizeof(text),
           "tai.field @%s_grad = @%s[\"grad\"] : f64, rank 0", name, tree);
  check(taiContextAddField(context, text, gradient));
  snprintf(text, sizeof(text),
           "tai.field @%s = @%s[\"x\"] : f64, rank 0, adjoint @%s_grad", name,
           tree, name);
  check(taiContextAddField(context, text, &field));
  return field;
}

static const char *const text =
    "tai.kernel @swing() {\n"
    "  %c0 = arith.constant 0 : index\n"
    "  %c1 = arith.constant 1 : index\n"
    "  %n = arith.constant 100 : index\n"
    "  %h = arith.constant 0.02 : f64\n"
    "  %k = arith.constant 20.0 : f64\n"
    "  %g = arith.constant 9.81 : f64\n"
    "  %goal = arith.constant -2.0 : f64\n"
    "  %rest = tai.load @rest[] : f64\n"
    "  %start = arith.constant -1.0 : f64\n"
    "  %still = arith.constant 0.0 : f64\n"
    "  %y, %v = scf.for %i = %c0 to %n step %c1\n"
    "      iter_args(%y0 = %start, %v0 = %still) -> (f64, f64) {\n"
    "    %stretch = arith.addf %y0, %rest : f64\n"
    "    %force = arith.mulf %k, %stretch : f64\n"
    "    %down = arith.addf %force, %g : f64\n"
    "    %dv = arith.mulf %h, %down : f64\n"
    "    %v1 = arith.subf %v0, %dv : f64\n"
    "    %dy = arith.mulf %h, %v1 : f64\n"
    "    %y1 = arith.addf %y0, %dy : f64\n"
    "    scf.yield %y1, %v1 : f64, f64\n"
    "  }\n"
    "  %miss = arith.subf %y, %goal : f64\n"
    "  %square = arith.mulf %miss, %miss : f64\n"
    "  %old = tai.atomic add %square, @loss[] : f64\n"
    "  tai.return\n"
    "}\n";

int main(void) {
  context = taiContextCreate();
  TaiField restGradient, lossGradient;
  TaiField rest = addField("rest", &restGradient);
  TaiField loss = addField("loss", &lossGradient);
  TaiKernel swing;
  check(taiKernelParse(context, text, "swing", "swing", &swing));

  double length = 1, miss = 0, slope = 0;
  for (int step = 0; step < 40; ++step) {
    TaiTape tape;
    check(taiFieldWriteF64(rest, NULL, 0, length));
    check(taiTapeBegin(context, loss, true, &tape));
    check(taiKernelLaunch(swing, NULL, 0, NULL));
    check(taiTapeEnd(tape));
    check(taiTapeBackward(tape));
    check(taiFieldReadF64(loss, NULL, 0, &miss));
    check(taiFieldReadF64(restGradient, NULL, 0, &slope));
    taiTapeDestroy(tape);
    length -= 0.2 * slope;
  }
  printf("rest length %.4f, loss %.1e\n", length, miss);
  taiContextDestroy(context);
  return 0;
}
