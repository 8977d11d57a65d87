/*===- program.c - Whole files through the C API ------------------*- C -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===*/

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <tai-c/Tai.h>

static TaiContext context;

static void check(TaiStatus status) {
  if (status != TAI_OK) {
    fprintf(stderr, "%s", taiContextLastError(context).diagnostics);
    exit(1);
  }
}

static void require(int holds, const char *what) {
  if (!holds) {
    fprintf(stderr, "wrong: %s\n", what);
    exit(1);
  }
}

/* Prints the message of an expected error. */
static void refused(const char *what, TaiStatus status) {
  TaiError error = taiContextLastError(context);
  require(status != TAI_OK, what);
  printf("%s: %d: ", what, status);
  if (error.line)
    printf("%s:%d:%d: ", error.file, error.line, error.column);
  printf("%s\n", error.message);
}

static TaiStatus load(const char *text, TaiProgram *program) {
  return taiProgramLoad(context, text, strlen(text), "text", program);
}

static TaiProgram energy;
static TaiStatus launchEnergy(void *user) {
  TaiKernel kernel;
  ++*(int *)user;
  check(taiProgramGetKernel(energy, "energy", &kernel));
  return taiKernelLaunch(kernel, NULL, 0, NULL);
}
static TaiStatus fail(void *user) {
  (void)user;
  return TAI_ERROR_RUNTIME;
}
static TaiStatus runMain(void *user) {
  return taiProgramRun((TaiProgram)user, "main");
}

static double readAt(TaiField field, int64_t index) {
  double value;
  check(taiFieldReadF64(field, &index, 0, &value));
  return value;
}

static int64_t countObjects(void) {
  TaiContextObjects objects;
  check(taiContextCountObjects(context, &objects));
  return objects.trees + objects.fields + objects.kernels +
         objects.kernel_handles;
}

/* Every null argument is an error. */
static void checkNulls(TaiField loss) {
  TaiProgram program;
  TaiField field;
  TaiKernel kernel;
  MlirModule none = {NULL}, module;
  refused("no bytes", taiProgramLoad(context, NULL, 0, "f", &program));
  refused("no program", taiProgramLoad(context, "", 0, "f", NULL));
  refused("no path", taiProgramLoadFile(context, NULL, &program));
  refused("no module", taiProgramCreate(context, none, &program));
  refused("no name", taiContextFindField(context, NULL, &field));
  refused("no field", taiContextFindField(context, "x", NULL));
  refused("no adjoint", taiFieldGetAdjoint(loss, NULL));
  refused("no kernel name", taiProgramGetKernel(energy, NULL, &kernel));
  refused("no kernel", taiProgramGetKernel(energy, "energy", NULL));
  refused("no function", taiProgramRun(energy, NULL));
  refused("no plugin", taiContextLoadPlugin(context, NULL));
  refused("nothing to read", taiModuleRead(context, NULL, 0, "f", &module));
  refused("no place", taiModuleRead(context, "", 0, "f", NULL));
  refused("no passes", taiModuleRunPasses(context, none, "cse"));
  refused("no code", taiContextRunFunction(context, NULL, NULL, 0, NULL, NULL));
  refused("no loss",
          taiCheckGradient(context, NULL, &loss, 1, 0, launchEnergy, NULL));
  refused("no run", taiCheckGradient(context, loss, &loss, 1, 0, NULL, NULL));
  refused("no fields",
          taiCheckGradient(context, loss, NULL, 1, 0, launchEnergy, NULL));
  require(taiProgramLoad(NULL, "", 0, "f", &program) == TAI_ERROR_USAGE,
          "no context");
  require(taiProgramRun(NULL, "main") == TAI_ERROR_USAGE, "no program");
  require(!taiProgramGetSymbol(NULL, TAI_SYMBOL_TREE, 0), "no symbols");
  taiProgramDestroy(NULL);
}

/* A file that fails leaves nothing. */
static void checkFailures(void) {
  TaiProgram program;
  int64_t before = countObjects();
  refused("syntax", load("tai.kernel @k() {\n  what\n}\n", &program));
  refused("type", load("tai.field @a = @nowhere[\"a\"] : f64, rank 0\n",
                       &program));
  refused("nested", load("module {\n  module {\n    tai.tree @t : !tai.root<{x: f64}>\n"
                         "  }\n}\n",
                         &program));
  refused("half", load("tai.tree @u : !tai.root<{x: f64}>\n"
                       "tai.field @u_x = @u[\"x\"] : f64, rank 0\n"
                       "tai.tree @data : !tai.root<{x: f64}>\n",
                       &program));
  refused("missing", taiProgramLoadFile(context, "/no/such.mlir", &program));
  require(countObjects() == before, "a failed load leaves nothing");

  char *deep = malloc(200001);
  memset(deep, '(', 100000);
  memset(deep + 100000, ')', 100000);
  deep[200000] = 0;
  require(load(deep, &program) == TAI_ERROR_SYNTAX, "deep text is refused");
  MlirModule module;
  check(taiModuleRead(context, "", 0, "empty", &module));
  require(taiModuleRunPasses(context, module, deep) == TAI_ERROR_SYNTAX,
          "a deep pipeline is refused");
  refused("pipeline", taiModuleRunPasses(context, module, "no-such-pass"));
  mlirModuleDestroy(module);
  free(deep);
}

/* Passes first, then a program of the module. */
static void checkPasses(void) {
  const char *text = "tai.tree @p : !tai.root<dense<[i: 4], {px: f64}>>\n"
                     "tai.field @px = @p[\"px\"] : f64, rank 1\n"
                     "func.func private @twice(%v: f64) -> f64 {\n"
                     "  %w = arith.addf %v, %v : f64\n"
                     "  return %w : f64\n"
                     "}\n"
                     "tai.kernel @double() {\n"
                     "  tai.parallel_for (%i) in @px {\n"
                     "    %v = tai.load @px[%i] : f64\n"
                     "    %w = func.call @twice(%v) : (f64) -> f64\n"
                     "    tai.store %w, @px[%i] : f64\n"
                     "  }\n"
                     "  tai.return\n"
                     "}\n"
                     "func.func @twice_over() {\n"
                     "  tai.launch @double() : () -> ()\n"
                     "  tai.launch @double() : () -> ()\n"
                     "  return\n"
                     "}\n";
  MlirModule module;
  TaiProgram program;
  TaiField px;
  check(taiModuleRead(context, text, strlen(text), "passes", &module));
  check(taiModuleRunPasses(context, module, "inline, canonicalize"));
  check(taiProgramCreate(context, module, &program));
  require(!taiProgramGetSymbol(program, TAI_SYMBOL_FUNCTION, 1),
          "the function is inlined, and gone");
  check(taiContextFindField(context, "@px", &px));
  check(taiFieldFillF64(px, 3));
  check(taiProgramRun(program, "@twice_over"));
  check(taiProgramRun(program, "twice_over"));
  require(readAt(px, 2) == 48, "four doublings");
  /* Its launches are recorded, and replayed. */
  TaiTape tape;
  check(taiTapeBegin(context, NULL, true, &tape));
  check(taiProgramRun(program, "twice_over"));
  check(taiTapeEnd(tape));
  require(taiTapeNumRecords(tape) > 0, "launches of a function are recorded");
  check(taiTapeReplay(tape, true, false));
  require(readAt(px, 1) == 768, "eight doublings");
  taiTapeDestroy(tape);
  /* A code option that changes between runs. */
  check(taiContextSetOption(context, "opt_level", "0"));
  check(taiProgramRun(program, "twice_over"));
  check(taiContextSetOption(context, "opt_level", "3"));
  require(readAt(px, 0) == 3072, "ten doublings");
  taiProgramDestroy(program);
  check(taiContextDestroyTree(context, "p"));
}

/* A dialect of examples/dialect, and the pass that lowers it. */
static void checkPlugin(const char *path) {
  const char *text = "tai.tree @s : !tai.root<{sx: f64}>\n"
                     "tai.field @sx = @s[\"sx\"] : f64, rank 0\n"
                     "tai.kernel @soften() {\n"
                     "  %v = tai.load @sx[] : f64\n"
                     "  %w = soft.plus %v : f64\n"
                     "  tai.store %w, @sx[] : f64\n"
                     "  tai.return\n"
                     "}\n";
  MlirModule module;
  TaiProgram program;
  TaiKernel soften;
  TaiField sx;
  double value;
  refused("without the plugin", load(text, &program));
  check(taiContextLoadPlugin(context, path));
  check(taiContextLoadPlugin(context, path));
  check(taiModuleRead(context, text, strlen(text), "soft", &module));
  check(taiModuleRunPasses(context, module, "lower-soft"));
  check(taiProgramCreate(context, module, &program));
  check(taiProgramGetKernel(program, "soften", &soften));
  check(taiContextFindField(context, "sx", &sx));
  check(taiKernelLaunch(soften, NULL, 0, NULL));
  check(taiFieldReadF64(sx, NULL, 0, &value));
  require(fabs(value - log(2)) < 1e-15, "log(1 + exp(0))");
  refused("too late", taiContextLoadPlugin(context, path));
  taiProgramDestroy(program);
  check(taiContextDestroyTree(context, "s"));
}

int main(int argc, char **argv) {
  require(argc >= 2, "the path of energy.mlir is the argument");
  context = taiContextCreate();
  check(taiContextSetOption(context, "cache_dir", ""));
  refused("plugin", taiContextLoadPlugin(context, "/no/such.so"));
  if (argc > 2 && strstr(argv[2], "TaiPlugin"))
    refused("tai itself", taiContextLoadPlugin(context, argv[2]));
  else if (argc > 2)
    checkPlugin(argv[2]);
  check(taiProgramLoadFile(context, argv[1], &energy));
  for (int kind = TAI_SYMBOL_TREE; kind <= TAI_SYMBOL_FUNCTION; ++kind) {
    const char *name;
    for (int i = 0; (name = taiProgramGetSymbol(energy, kind, i)); ++i)
      printf("%s@%s", i ? " " : "", name);
    printf("\n");
  }

  /* @main has a tape of its own. */
  TaiField x, gradient, loss;
  check(taiProgramRun(energy, "main"));
  check(taiContextFindField(context, "x", &x));
  check(taiContextFindField(context, "@loss", &loss));
  check(taiFieldGetAdjoint(x, &gradient));
  for (int i = 0; i < 4; ++i)
    require(fabs(readAt(gradient, i) - sin(i)) < 1e-14, "d sin^2(i/2) = sin i");

  /* The same by the tape of the caller. */
  TaiKernel kernel, again;
  TaiTape tape;
  check(taiProgramGetKernel(energy, "@energy", &kernel));
  check(taiProgramGetKernel(energy, "energy", &again));
  require(kernel == again, "one handle");
  check(taiFieldFillF64(x, 0.25));
  check(taiTapeBegin(context, loss, true, &tape));
  check(taiKernelLaunch(kernel, NULL, 0, NULL));
  check(taiTapeEnd(tape));
  check(taiTapeBackward(tape));
  require(fabs(readAt(gradient, 3) - sin(0.5)) < 1e-14, "the caller's tape");
  taiTapeDestroy(tape);

  /* Stores of a function itself are no launches. */
  check(taiTapeBegin(context, NULL, true, &tape));
  refused("under a tape", taiProgramRun(energy, "main"));
  check(taiTapeEnd(tape));
  taiTapeDestroy(tape);

  int runs = 0;
  check(taiCheckGradient(context, loss, &x, 1, 1e-6, launchEnergy, &runs));
  require(runs > 10, "the function is called for each difference");
  require(readAt(x, 0) == 0.25, "the fields are restored");
  refused("no gradient", taiCheckGradient(context, loss, &gradient, 1, 1e-6,
                                          launchEnergy, &runs));
  refused("tolerance", taiCheckGradient(context, loss, &x, 1, -1, launchEnergy,
                                        &runs));
  refused("failing", taiCheckGradient(context, loss, &x, 1, 1, fail, NULL));
  refused("tapes in it",
          taiCheckGradient(context, loss, &x, 1, 1e-6, runMain, energy));
  taiKernelDestroy(kernel);
  check(taiProgramGetKernel(energy, "energy", &kernel));
  check(taiKernelLaunch(kernel, NULL, 0, NULL));

  refused("again", taiProgramLoadFile(context, argv[1], &energy));
  refused("field", taiContextFindField(context, "y", &x));
  refused("adjoint", taiFieldGetAdjoint(gradient, &x));
  refused("kernel", taiProgramGetKernel(energy, "main", &kernel));
  refused("function", taiProgramRun(energy, "energy"));
  refused("late plugin", taiContextLoadPlugin(context, "/no/such.so"));
  checkNulls(loss);
  checkFailures();
  checkPasses();
  taiProgramDestroy(energy);
  check(taiContextDestroyTree(context, "data"));
  require(countObjects() == 0, "nothing is left");
  taiContextDestroy(context);
  printf("done\n");
  return 0;
}
