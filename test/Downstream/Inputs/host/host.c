/* y = sum of (a x[i])^2 and its gradient 2 a^2 x[i], by a tape. Ends with 1 if a
   number is wrong. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <tai-c/Tai.h>

#if TAI_VERSION_NUMBER < TAI_MAKE_VERSION(0, 2, 0) || TAI_VERSION_MAJOR > 0
#error "another tai"
#endif

static TaiContext context;

static void check(TaiStatus status) {
  if (status == TAI_OK)
    return;
  fprintf(stderr, "%s\n", taiContextLastError(context).diagnostics);
  exit(1);
}

static TaiField addField(const char *declaration) {
  TaiField field;
  check(taiContextAddField(context, declaration, &field));
  return field;
}

static const char *const text =
    "tai.kernel @energy(%a: f64) {\n"
    "  tai.parallel_for (%i) in @x {\n"
    "    %v = tai.load @x[%i] : f64\n"
    "    %w = arith.mulf %a, %v : f64\n"
    "    %e = arith.mulf %w, %w : f64\n"
    "    %old = tai.atomic add %e, @y[] : f64\n"
    "  }\n"
    "  tai.return\n"
    "}\n";

int main(void) {
  /* The headers and the library are of one version. */
  if (taiVersionNumber() != TAI_VERSION_NUMBER ||
      strcmp(taiVersion(), TAI_VERSION_STRING) != 0)
    return 1;

  context = taiContextCreate();
  check(taiContextSetOption(context, "cache_dir", ""));
  check(taiContextAddTree(context, "t",
                          "!tai.root<dense<[i: 1000], {x: f64, gx: f64}>, "
                          "{y: f64, gy: f64}>"));
  TaiField gx = addField("tai.field @gx = @t[\"gx\"] : f64, rank 1");
  TaiField x = addField("tai.field @x = @t[\"x\"] : f64, rank 1, adjoint @gx");
  addField("tai.field @gy = @t[\"gy\"] : f64, rank 0");
  TaiField y = addField("tai.field @y = @t[\"y\"] : f64, rank 0, adjoint @gy");

  TaiFieldInfo info;
  check(taiFieldGetInfo(x, &info));
  if (info.rank != 1 || info.shape[0] != 1000 || info.type != TAI_F64)
    return 1;

  double values[1000], gradient[1000], result, expected = 0, a = 3;
  for (int i = 0; i < 1000; ++i) {
    values[i] = 0.001 * i - 0.3;
    expected += 9 * values[i] * values[i];
  }
  check(taiFieldCopyFromHost(x, values));

  TaiKernel energy;
  TaiTape tape;
  uint64_t argument;
  memcpy(&argument, &a, sizeof(a));
  check(taiKernelParse(context, text, "energy", "energy", &energy));
  check(taiTapeBegin(context, y, true, &tape));
  check(taiKernelLaunch(energy, &argument, 1, NULL));
  check(taiTapeEnd(tape));
  check(taiTapeBackward(tape));
  check(taiFieldReadF64(y, NULL, 0, &result));
  check(taiFieldCopyToHost(gx, gradient));
  if (fabs(result - expected) > 1e-12 * expected)
    return 1;
  for (int i = 0; i < 1000; ++i)
    if (fabs(gradient[i] - 18 * values[i]) > 1e-12)
      return 1;
  taiTapeDestroy(tape);
  taiContextDestroy(context);
  printf("host: y = %.6f, dy/dx[0] = %.1f\n", result, gradient[0]);
  return 0;
}
