// RUN: tai-run %s --no-cache --print-field=@x,@n,@b,@v,@s,@z | FileCheck %s
// RUN: tai-opt %s | tai-run - --no-cache --print-field=@x,@n,@b,@v,@s,@z | FileCheck %s
// RUN: tai-translate --tai-to-bytecode %s -o %t.bin
// RUN: tai-run %t.bin --no-cache --print-field=@x,@n,@b,@v,@s,@z | FileCheck %s
// RUN: sed -e 's/blob: "0x0400/blob: "0x0100/' -e 's/0000803f00000040/00000000/' %s > %t.mlir
// RUN: not tai-run %t.mlir 2>&1 | FileCheck %s --check-prefix=SHORT

// Fields of all kinds begin with their contents: row-major, whatever the layout.
tai.tree @t : !tai.root<dense<[j: 2], dense<[i: 3], {x: f32}>>,
                        dense<[i: 2], {n: i32, b: i1, v: vector<2xf64>, z: f32}>,
                        pointer<[i: 4], {s: f64}>>
// CHECK: @x : 3x2xf32 =
// CHECK-NEXT: {{\[\[1, 2\],}}
// CHECK-NEXT: {{ \[3, 4\],}}
// CHECK-NEXT: {{ \[5, 6\]\]}}
tai.field @x = @t["x"] : f32, rank 2, initial dense<[[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]> : tensor<3x2xf32>
// CHECK: @n : 2xi32 = [7, 7]
tai.field @n = @t["n"] : i32, rank 1, initial dense<7> : tensor<2xi32>
// CHECK: @b : 2xi1 = [0, 1]
tai.field @b = @t["b"] : i1, rank 1, initial dense<[false, true]> : tensor<2xi1>
// CHECK: @v : 2xvector<2xf64> =
// CHECK: {{\[\[1, 2\],}}
// CHECK-NEXT: {{\[3, 4\]\]}}
tai.field @v = @t["v"] : vector<2xf64>, rank 1, offset [5], initial dense<[[1.0, 2.0], [3.0, 4.0]]> : tensor<2x2xf64>
// CHECK: @s : 4xf64 = [0, 0, 9, 0]
tai.field @s = @t["s"] : f64, rank 1, initial dense<[0.0, 0.0, 9.0, 0.0]> : tensor<4xf64>
// CHECK: @z : 2xf32 = [1, 2]
tai.field @z = @t["z"] : f32, rank 1, initial dense_resource<blob> : tensor<2xf32>
// SHORT: error: the initial contents of '@z' have 4 bytes, but its elements take 8

func.func @main() { return }

{-#
  dialect_resources: { builtin: { blob: "0x040000000000803f00000040" } }
#-}
