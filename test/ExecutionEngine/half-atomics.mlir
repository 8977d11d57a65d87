// RUN: tai-run %s --no-cache --print-field=@h,@b | FileCheck %s
// RUN: tai-run %s --no-cache --opt-level=0 --print-field=@h,@b | FileCheck %s
// RUN: env TAI_CUDA_EMULATION=1 tai-run %s --no-cache --arch=cuda --print-field=@h,@b | FileCheck %s
// RUN: tai-run %s --no-cache --opt-level=0 --print-ir=llvmir 2>&1 | FileCheck %s --check-prefix=IR

// The bits in memory are compared and exchanged. As a float, a signalling NaN
// of 16 bits is another one after a detour through 32, and a denormal bf16 may
// be zero: the exchange would be tried for ever.

tai.tree @t : !tai.root<dense<[i: 4], {h: f16, b: bf16}>,
                     dense<[i: 4096], {p: i32, q: f16, r: bf16}>>
tai.field @h = @t["h"] : f16, rank 1
tai.field @b = @t["b"] : bf16, rank 1
tai.field @p = @t["p"] : i32, rank 1
tai.field @q = @t["q"] : f16, rank 1
tai.field @r = @t["r"] : bf16, rank 1

tai.kernel @set(%nan: i16, %least: i16) {
  tai.parallel_for (%i) in @h {
    %x = arith.bitcast %nan : i16 to f16
    tai.store %x, @h[%i] : f16
    %y = arith.bitcast %least : i16 to bf16
    tai.store %y, @b[%i] : bf16
  }
  tai.return
}

// IR-NOT: atomicrmw {{f[a-z]+}} {{.*}} half
// IR-NOT: atomicrmw {{f[a-z]+}} {{.*}} bfloat
// IR:     cmpxchg ptr {{.*}} i16
tai.kernel @add(%one: f16, %two: bf16) {
  tai.parallel_for (%i) in @p {
    %n = tai.load @p[%i] : i32
    %at = arith.index_cast %n : i32 to index
    %0 = tai.atomic add %one, @h[%at] : f16
    tai.store %0, @q[%i] : f16
    %1 = tai.atomic add %two, @b[%at] : bf16
    tai.store %1, @r[%i] : bf16
  }
  tai.return
}

// CHECK: @h : 4xf16 = [nan, nan, nan, nan]
// CHECK: @b : 4xbf16 = [512,
func.func @main() {
  %nan = arith.constant 0x7C01 : i16
  %least = arith.constant 1 : i16
  tai.launch @set(%nan, %least) : (i16, i16) -> ()
  %one = arith.constant 1.0 : f16
  %two = arith.constant 2.0 : bf16
  tai.launch @add(%one, %two) : (f16, bf16) -> ()
  return
}
