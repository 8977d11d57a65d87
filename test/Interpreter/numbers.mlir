// RUN: tai-run %s --interpret --no-cache --print-field=@w,@n,@h,@d,@t,@b | FileCheck %s
// RUN: tai-run %s --no-cache --print-field=@w,@n,@h,@d,@t,@b | FileCheck %s

// Arithmetic is that of the type of each operation: the expected numbers are
// worked out by hand, and compiled code has the same.

tai.tree @s : !tai.root<dense<[i: 12], {w: i8, n: i32, h: f16, d: f64, t: i1, b: bf16}>>
tai.field @w = @s["w"] : i8, rank 1
tai.field @n = @s["n"] : i32, rank 1
tai.field @h = @s["h"] : f16, rank 1
tai.field @d = @s["d"] : f64, rank 1
tai.field @t = @s["t"] : i1, rank 1
tai.field @b = @s["b"] : bf16, rank 1

// Eight bits wrap; the smallest has no negative; shifts take the sign along.
// CHECK: @w : 12xi8 = [-56, -128, -128, -2, 127, 16, 0, -128, 3, 127, 4, 5]
tai.kernel @bytes(%x: i8, %y: i8, %zero: i8, %minus: i8, %least: i8) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c3 = arith.constant 3 : index
  %c4 = arith.constant 4 : index
  %c5 = arith.constant 5 : index
  %c6 = arith.constant 6 : index
  %c7 = arith.constant 7 : index
  %c8 = arith.constant 8 : index
  %c9 = arith.constant 9 : index
  %c10 = arith.constant 10 : index
  %c11 = arith.constant 11 : index
  %one = arith.constant 1 : i8
  %three = arith.constant 3 : i8
  %sum = arith.addi %x, %y : i8
  tai.store %sum, @w[%c0] : i8
  %abs = math.absi %least : i8
  tai.store %abs, @w[%c1] : i8
  %quotient = arith.divsi %least, %minus : i8
  tai.store %quotient, @w[%c2] : i8
  // -16 >> 3, once with the sign and once without.
  %sixteen = arith.constant -16 : i8
  %arithmetic = arith.shrsi %sixteen, %three : i8
  tai.store %arithmetic, @w[%c3] : i8
  %half = arith.shrui %minus, %one : i8
  tai.store %half, @w[%c4] : i8
  // As a number without sign, -128 is 128.
  %eight = arith.constant 8 : i8
  %unsigned = arith.divui %least, %eight : i8
  tai.store %unsigned, @w[%c5] : i8
  %none = arith.divui %x, %zero : i8
  tai.store %none, @w[%c6] : i8
  %smaller = arith.minsi %least, %y : i8
  tai.store %smaller, @w[%c7] : i8
  %ones = math.ctpop %three : i8
  %more = arith.addi %ones, %one : i8
  tai.store %more, @w[%c8] : i8
  %larger = arith.maxui %three, %y : i8
  %largest = arith.constant 127 : i8
  %capped = arith.maxsi %larger, %largest : i8
  tai.store %capped, @w[%c9] : i8
  // 11 / 3 rounded up, and 21 / 4 rounded down.
  %eleven = arith.constant 11 : i8
  %up = arith.ceildivsi %eleven, %three : i8
  tai.store %up, @w[%c10] : i8
  %twentyone = arith.constant 21 : i8
  %four = arith.constant 4 : i8
  %down = arith.floordivsi %twentyone, %four : i8
  tai.store %down, @w[%c11] : i8
  tai.return
}

// CHECK: @n : 12xi32 = [-3, 3, -1, 2147483647, 255, -1, 0, 0, 0, 0, 0, 0]
tai.kernel @casts(%f: f32, %byte: i8, %wide: i64) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c3 = arith.constant 3 : index
  %c4 = arith.constant 4 : index
  %c5 = arith.constant 5 : index
  %toZero = arith.fptosi %f : f32 to i32
  tai.store %toZero, @n[%c0] : i32
  %minus = arith.negf %f : f32
  %noSign = arith.fptoui %minus : f32 to i32
  tai.store %noSign, @n[%c1] : i32
  %rest = arith.remsi %toZero, %noSign : i32
  %low = arith.trunci %wide : i64 to i32
  tai.store %low, @n[%c2] : i32
  %one = arith.constant 1 : i32
  %half = arith.shrui %low, %one : i32
  tai.store %half, @n[%c3] : i32
  %plain = arith.extui %byte : i8 to i32
  tai.store %plain, @n[%c4] : i32
  %signed = arith.extsi %byte : i8 to i32
  tai.store %signed, @n[%c5] : i32
  tai.return
}

// 2049 lies between two f16, and goes to the even one; so does 1/3.
// CHECK: @h : 12xf16 = [2048, 0.3333, inf, -0, 6e-08, nan, 0, 0, 0, 0, 0, 0]
tai.kernel @halves(%big: f16, %one: f16, %three: f16, %least: f16) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c3 = arith.constant 3 : index
  %c4 = arith.constant 4 : index
  %c5 = arith.constant 5 : index
  %sum = arith.addf %big, %one : f16
  tai.store %sum, @h[%c0] : f16
  %third = arith.divf %one, %three : f16
  tai.store %third, @h[%c1] : f16
  %square = arith.mulf %big, %big : f16
  tai.store %square, @h[%c2] : f16
  %zero = arith.constant 0.0 : f16
  %negative = arith.negf %zero : f16
  %minimum = arith.minimumf %zero, %negative : f16
  tai.store %minimum, @h[%c3] : f16
  tai.store %least, @h[%c4] : f16
  %nan = arith.divf %zero, %zero : f16
  tai.store %nan, @h[%c5] : f16
  tai.return
}

// The number beside a NaN is what minnumf and maxnumf take; minimumf takes NaN.
// CHECK: @d : 12xf64 = [2, nan, -3, 3, 2, -2, 0.5, -1.5, 1, 4, 0, 0]
tai.kernel @doubles(%two: f64) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c3 = arith.constant 3 : index
  %c4 = arith.constant 4 : index
  %c5 = arith.constant 5 : index
  %c6 = arith.constant 6 : index
  %c7 = arith.constant 7 : index
  %c8 = arith.constant 8 : index
  %c9 = arith.constant 9 : index
  %nan = arith.constant 0x7FF8000000000000 : f64
  %a = arith.maxnumf %two, %nan : f64
  tai.store %a, @d[%c0] : f64
  %b = arith.minimumf %two, %nan : f64
  tai.store %b, @d[%c1] : f64
  %x = arith.constant -2.5 : f64
  %floor = math.floor %x : f64
  tai.store %floor, @d[%c2] : f64
  %y = arith.constant 2.5 : f64
  %away = math.round %y : f64
  tai.store %away, @d[%c3] : f64
  %even = math.roundeven %y : f64
  tai.store %even, @d[%c4] : f64
  %ceil = math.ceil %x : f64
  tai.store %ceil, @d[%c5] : f64
  // The remainder has the sign of the dividend.
  %rest = arith.remf %y, %two : f64
  tai.store %rest, @d[%c6] : f64
  %z = arith.constant 1.5 : f64
  %signed = math.copysign %z, %x : f64
  tai.store %signed, @d[%c7] : f64
  %one = arith.constant 1.0 : f64
  %four = arith.constant 4.0 : f64
  %root = math.sqrt %four : f64
  %quotient = arith.divf %two, %root : f64
  tai.store %quotient, @d[%c8] : f64
  %fused = math.fma %two, %one, %two : f64
  tai.store %fused, @d[%c9] : f64
  tai.return
}

// CHECK: @t : 12xi1 = [1, 0, 1, 0, 1, 1, 0, 1, 0, 0, 0, 0]
tai.kernel @truths(%x: f32, %least: i8) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c3 = arith.constant 3 : index
  %c4 = arith.constant 4 : index
  %c5 = arith.constant 5 : index
  %c6 = arith.constant 6 : index
  %c7 = arith.constant 7 : index
  %zero = arith.constant 0 : i8
  %signed = arith.cmpi slt, %least, %zero : i8
  tai.store %signed, @t[%c0] : i1
  %unsigned = arith.cmpi ult, %least, %zero : i8
  tai.store %unsigned, @t[%c1] : i1
  %infinity = arith.constant 0x7F800000 : f32
  %nan = arith.subf %infinity, %infinity : f32
  %isInf = math.isinf %infinity : f32
  tai.store %isInf, @t[%c2] : i1
  %isNanInf = math.isinf %nan : f32
  tai.store %isNanInf, @t[%c3] : i1
  %unordered = arith.cmpf ult, %nan, %x : f32
  tai.store %unordered, @t[%c4] : i1
  %normal = math.isnormal %x : f32
  tai.store %normal, @t[%c5] : i1
  %tiny = arith.constant 1.0e-40 : f32
  %denormal = math.isnormal %tiny : f32
  tai.store %denormal, @t[%c6] : i1
  %minus = arith.negf %infinity : f32
  %isMinusInf = math.isinf %minus : f32
  tai.store %isMinusInf, @t[%c7] : i1
  tai.return
}

// Eight bits of significand: 257 is 256, and 1 + 2^-8 is 1.
// CHECK: @b : 12xbf16 = [256, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]
tai.kernel @brains(%x: f32, %y: bf16) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %narrow = arith.truncf %x : f32 to bf16
  tai.store %narrow, @b[%c0] : bf16
  %one = arith.constant 1.0 : bf16
  %sum = arith.addf %one, %y : bf16
  tai.store %sum, @b[%c1] : bf16
  tai.return
}

func.func @main() {
  %hundred = arith.constant 100 : i8
  %zero8 = arith.constant 0 : i8
  %minus8 = arith.constant -1 : i8
  %least8 = arith.constant -128 : i8
  tai.launch @bytes(%hundred, %hundred, %zero8, %minus8, %least8) : (i8, i8, i8, i8, i8) -> ()
  %f = arith.constant -3.7 : f32
  %wide = arith.constant 0x1FFFFFFFF : i64
  tai.launch @casts(%f, %minus8, %wide) : (f32, i8, i64) -> ()
  %big = arith.constant 2048.0 : f16
  %one = arith.constant 1.0 : f16
  %three = arith.constant 3.0 : f16
  %least = arith.constant 0x0001 : f16
  tai.launch @halves(%big, %one, %three, %least) : (f16, f16, f16, f16) -> ()
  %two = arith.constant 2.0 : f64
  tai.launch @doubles(%two) : (f64) -> ()
  %x = arith.constant 1.0 : f32
  tai.launch @truths(%x, %least8) : (f32, i8) -> ()
  %odd = arith.constant 257.0 : f32
  %small = arith.constant 0.00390625 : bf16
  tai.launch @brains(%odd, %small) : (f32, bf16) -> ()
  return
}
